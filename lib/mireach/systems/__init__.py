"""What is analysed: maxout networks, piecewise-affine systems, the closed loop, example plants."""
