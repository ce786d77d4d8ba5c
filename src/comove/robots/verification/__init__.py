"""Verification of joint motions, by Pinocchio's kinematics and coal's distances; it shares no code with
`comove.robots.search`.
"""
