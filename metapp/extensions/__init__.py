"""Extensions: what the core never imports and finds by its door, each with its code, tests and a README."""
