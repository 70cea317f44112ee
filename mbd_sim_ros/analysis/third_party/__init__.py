"""Programs of others that stand in web pages, unchanged, with their licences."""
