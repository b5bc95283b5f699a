"""The mathematics of learning: tasks, applications, recipes, learn, its adjoint, update rules."""
