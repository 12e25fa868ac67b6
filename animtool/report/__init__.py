"""Descriptions of files, comparisons of takes, and text of reports."""
