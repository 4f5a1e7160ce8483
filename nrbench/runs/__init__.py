"""A run on disk: its folders and files, and the tables read from them."""
