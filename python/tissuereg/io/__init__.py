"""Reading and writing of files: one module for each format; units are converted in these modules and nowhere else.

Readers import the libraries that they need on first use only, so that importing tissuereg stays quick. Writers write a
whole file or none.
"""
