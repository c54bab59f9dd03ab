"""What people look at: the picture, the page, the files of a registration."""
