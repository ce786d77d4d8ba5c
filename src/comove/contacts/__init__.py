"""Contacts: distances of a payload and end effectors from all that they must not touch, in one set of kernels."""
