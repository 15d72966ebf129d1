"""The held body in other engines, installed with the optional extra `peers`."""
