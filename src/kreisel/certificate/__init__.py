"""Certificates of calibrations: one page, in HTML and PDF, in German and English, signed."""
