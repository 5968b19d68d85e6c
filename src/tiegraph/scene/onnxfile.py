"""Networks in ONNX files of the user's, run by ONNX Runtime."""

from pathlib import Path
from typing import Any

from tiegraph.errors import InputError, optional
from tiegraph.scene.atomic import cached_by_file


@cached_by_file(maxsize=2)
def session(onnx: Path, setting: str) -> Any:
    """A session of ONNX Runtime, on one thread. Raises InputError for a file that is no model, EngineMissing without
    ONNX Runtime, which ``setting`` needs."""
    onnxruntime = optional("onnxruntime", "onnx", setting)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1  # images run side by side already
    options.enable_cpu_mem_arena = False  # it would keep the memory of every image
    try:
        return onnxruntime.InferenceSession(str(onnx), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # ONNX Runtime raises classes of its own that share no base
        raise InputError(f"{onnx}: not a model ONNX Runtime can load: {error}") from None
