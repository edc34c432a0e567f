"""The page and the reports."""
