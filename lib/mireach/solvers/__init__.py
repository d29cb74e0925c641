"""Linear and mixed-integer programs, with bounds that do not rest on the solver."""
