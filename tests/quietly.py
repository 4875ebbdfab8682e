"""Encode without warnings, for tests that do not look at them."""

from __future__ import annotations

import warnings
from typing import Any

from cndhf_codec import CndhfWarning, Model, Report, encode


def encode_quietly(source: Any, **options: Any) -> tuple[Model, Report]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CndhfWarning)
        model = encode(source, **options)
    return model, model.report
