"""BRDFs as Mitsuba 3 has them: files of the RGL material database, and scenes that show fits."""
