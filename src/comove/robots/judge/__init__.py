"""The judge of joint motions: Pinocchio's kinematics, coal's distances, nothing of `comove.robots.search`."""
