"""Recordings in motion: what is drawn of a model (drawing), where it is (motion), a web page (page) and pictures
(picture)."""
