"""Opens networks in the ONNX format with onnxruntime."""

from __future__ import annotations

import os
from typing import Any

from ..errors import FileMissing, FormatError
from .extras import needed


def opened(path: str) -> Any:
    """Opens a session on one CPU thread.

    Raises:
        FileMissing, FormatError: for a file that is missing, or is no network.
    """
    runtime = needed("onnxruntime")
    if not os.path.exists(path):
        raise FileMissing(f"{path}: there is no such network")
    options = runtime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    try:
        return runtime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    except Exception as error:
        raise FormatError(f"{path}: onnxruntime cannot read this network: {error}") from error
