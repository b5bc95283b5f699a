"""Extensions: what the core never imports, each with its code, tests and a README; `contents` has their entries."""
