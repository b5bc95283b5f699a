"""Extensions: packages that the core never imports, with tests and a README; `contents` has their entries."""
