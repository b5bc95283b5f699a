"""Tables, figures, the report and the study of rules: what runs are measured for."""
