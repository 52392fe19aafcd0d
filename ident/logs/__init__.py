"""The loop on logs: trajectories and torques of a robot with rigid joints, instead of frequency responses."""
