"""The report: one static HTML page of all tables, figures, pictures and records, which needs no network."""
