"""Trained models and their files: base poses, the lifter, and the standard deviations of joint positions."""
