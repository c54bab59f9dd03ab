"""Commands that make the archives of `paper/archive` and the pages of `paper/pages` from them."""
