"""A thread that all drawing of a process is done in."""

from __future__ import annotations

import functools
import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Callable

import cv2


def in_own_thread(call: Callable[..., Any], *arguments: Any) -> Any:
    """Call something in the one thread of this process that draws, and return what it returns.

    PyBullet and the graphics library do not like to change threads, and who runs tasks (Dask)
    does not promise to keep to one.
    """
    return _thread().submit(call, *arguments).result()


@functools.lru_cache(maxsize=None)
def _thread() -> ThreadPoolExecutor:
    # Graphics and vision would start a thread for each core; the cores have a process each.
    os.environ.setdefault("LP_NUM_THREADS", "1")
    cv2.setNumThreads(1)
    return ThreadPoolExecutor(max_workers=1, thread_name_prefix="drawing")
