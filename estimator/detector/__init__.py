"""From a frame to a spot: the paper's literal algorithm and the sub-pixel mode."""
