"""Tensors of a PyTorch file, without PyTorch: its archive holds a pickle, of which only what builds
tensors is allowed.
"""

from __future__ import annotations

import collections
import io
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.data.importers.runs import first_line, refused


_TYPES = {
    "DoubleStorage": "<f8",
    "FloatStorage": "<f4",
    "HalfStorage": "<f2",
    "LongStorage": "<i8",
    "IntStorage": "<i4",
    "ShortStorage": "<i2",
    "CharStorage": "i1",
    "ByteStorage": "u1",
    "BoolStorage": "?",
}


class _Tensors(pickle.Unpickler):
    """Refuses every name but those that stand for a tensor, so that no code of the file can run."""

    def __init__(self, archive: zipfile.ZipFile, member: str):
        super().__init__(io.BytesIO(archive.read(member)))
        self.archive, self.folder = archive, member.rpartition("/")[0]

    def find_class(self, module: str, name: str) -> Any:
        if module == "torch" and name in _TYPES:
            return name
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return _tensor
        if (module, name) == ("collections", "OrderedDict"):
            return collections.OrderedDict
        raise pickle.UnpicklingError(f"it holds {module}.{name}, and only tensors are read")

    def persistent_load(self, pid: Any) -> np.ndarray:
        _, kind, key, *_ = pid
        return np.frombuffer(self.archive.read(f"{self.folder}/data/{key}"), dtype=_TYPES[kind])


def _tensor(
    storage: np.ndarray, offset: int, size: tuple[int, ...], stride: tuple[int, ...], *_: Any
) -> np.ndarray:
    last = (
        offset + sum((n - 1) * s for n, s in zip(size, stride, strict=True))
        if all(size)
        else offset - 1
    )
    if min((offset, *size, *stride, 0)) < 0 or last >= len(storage):
        raise pickle.UnpicklingError("a tensor reaches beyond what is stored of it")
    width = storage.dtype.itemsize
    view = np.lib.stride_tricks.as_strided(
        storage[offset:], tuple(size), tuple(s * width for s in stride), writeable=False
    )
    return view.copy()


def read_tensors(path: Path) -> dict[str, Any]:
    """name -> array, nested as in the file; one tensor alone is `data`. Raises `DatasetError` for
    any other content.
    """
    remedy = (
        "Write tensors alone: torch.save({'t': t, 'q': q}, 'log.pt'), or numpy.savez('log.npz',"
        " t=t.numpy(), q=q.numpy())"
    )
    if not zipfile.is_zipfile(path):
        raise refused(
            path, "a file of PyTorch older than 1.6, a plain pickle, which is not read", remedy
        )
    try:
        with zipfile.ZipFile(path) as archive:
            member = next(n for n in archive.namelist() if n.rpartition("/")[2] == "data.pkl")
            if f"{member.rpartition('/')[0]}/byteorder" in archive.namelist():
                if archive.read(f"{member.rpartition('/')[0]}/byteorder").strip() != b"little":
                    raise refused(path, "written on a big-endian machine", remedy)
            content = _Tensors(archive, member).load()
    except (
        pickle.UnpicklingError,
        zipfile.BadZipFile,
        KeyError,
        IndexError,
        ValueError,
        TypeError,
        AttributeError,
        EOFError,
    ) as e:
        if type(e).__name__ == "DatasetError":
            raise
        raise refused(path, f"not readable as tensors ({first_line(e)})", remedy) from None
    return dict(content) if isinstance(content, dict) else {"data": content}
