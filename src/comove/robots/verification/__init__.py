"""Verification of joint motions by Pinocchio and coal, independent of `comove.robots.search`."""
