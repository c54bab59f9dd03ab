"""Is the spread of the trained model honest?"""
