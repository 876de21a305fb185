"""What many modules of tests mean by the same name."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[1]
S = 1_000_000_000
"""Nanoseconds of a second."""
PATIENCE_S = 120.0
"""After so long what is waited for does not come; a busy machine takes its time."""
