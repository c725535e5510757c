"""A station of a production line: units are recorded, calibrated and judged; an operator has one page."""
