"""The base of applications that generate, from noise, pictures with the statistics of an exemplar photograph."""
