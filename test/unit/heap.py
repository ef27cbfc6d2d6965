"""What the C library has given out, to the byte: what is resident moves by megabytes."""

import ctypes
import gc

_FIELDS = "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost"
_C = ctypes.CDLL(None)
# glibc has it from 2.33 on.
_HAS_SECOND = hasattr(_C, "mallinfo2")
_mallinfo = _C.mallinfo2 if _HAS_SECOND else _C.mallinfo
_KIND = ctypes.c_size_t if _HAS_SECOND else ctypes.c_int


class _Info(ctypes.Structure):
    _fields_ = tuple((name, _KIND) for name in _FIELDS.split())


_mallinfo.restype = _Info


def bytes_kept(call, count):
    """What a call leaves behind, after as many to warm up: the mean of so many, in bytes."""
    used = []
    for _ in range(2):
        for _ in range(count):
            call()
        gc.collect()
        info = _mallinfo()
        used.append(info.uordblks + info.hblkhd)
    return (used[1] - used[0]) / count
