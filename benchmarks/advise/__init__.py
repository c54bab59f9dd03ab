"""How much is advice on markers worth?"""
