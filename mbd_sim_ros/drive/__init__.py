"""A car in a page of this machine: hands, pages, and what moves it (docs/driving.md)."""
