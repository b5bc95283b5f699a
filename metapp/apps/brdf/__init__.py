"""BRDFs on half and difference vectors (paper section 4.1.2): the NBRDF network, or one of learned features."""
