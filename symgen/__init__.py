"""A URDF becomes a plan: J_ii(q) = C_i(q) alpha_i, the postures that measure alpha, and code for both."""
