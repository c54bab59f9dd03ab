"""Tests of this bench."""
