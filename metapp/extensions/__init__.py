"""Extensions: what the core never imports and finds in its registry, each with its code, tests and a README."""
