"""The simulated robot: MuJoCo, the locks of its joints, undeclared effects in it, and the campaigns it plays."""
