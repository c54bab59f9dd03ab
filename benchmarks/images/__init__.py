"""Exactness and times of fields, grid transforms and warped images; thousands of targets."""
