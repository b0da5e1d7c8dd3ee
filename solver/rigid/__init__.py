"""Rigid bodies: free motion, contact with friction, joints."""
