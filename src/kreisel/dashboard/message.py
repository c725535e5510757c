"""What a page is sent."""

from __future__ import annotations

from typing import Any

Message = dict[str, Any]
"""A message; it is sent as JSON."""
