"""Blind test bench: experiments with a hidden effect, made by another code path, and their scores."""
