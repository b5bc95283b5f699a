"""General of flash photos over frozen features of VGG-16, and real materials to train it on."""
