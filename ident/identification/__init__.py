"""A campaign becomes J(q): by every estimator, as links that can exist, with what is still in doubt, as files for others."""
