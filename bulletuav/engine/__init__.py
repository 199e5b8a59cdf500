"""Bullet: the only room that calls pybullet."""
