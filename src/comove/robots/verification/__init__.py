"""Verification of joint motions, on Pinocchio's models and coal's shapes; it shares no code with
`comove.robots.search`.
"""
