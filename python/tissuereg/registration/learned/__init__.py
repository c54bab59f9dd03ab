"""Latent models: trained networks and principal components, behind one protocol."""
