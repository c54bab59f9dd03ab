"""Bench of rigs drawn at random and solved by foreign codes."""
