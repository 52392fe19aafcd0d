"""The search for one effect more: what could explain a residual, tried, compared, fitted to its minimum, kept if it earns its place."""
