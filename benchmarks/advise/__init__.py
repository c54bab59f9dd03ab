"""What advice on markers is worth."""
