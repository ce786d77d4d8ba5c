"""Export: verified joint motions as files and messages that robots play."""
