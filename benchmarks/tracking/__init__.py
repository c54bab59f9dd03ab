"""What are the frames before worth, and how fast is tracking?"""
