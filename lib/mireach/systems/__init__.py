"""What is analysed: maxout networks, piecewise-affine and nonlinear systems, the closed loop, example plants."""
