"""Path guiding while rendering: an integrator of Mitsuba 3, and `--render` of transport."""
