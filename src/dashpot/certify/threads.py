"""One BLAS thread for small matrices.

A linear algebra library that hands matrices of ten rows to several threads spends its time waiting for them:
up to fifty times as long on a busy machine.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

_depth = 0


@functools.cache
def _controller() -> Any:
    import scipy.linalg  # noqa: F401 - both bring a library of their own, which must be loaded to be found
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")


def one_thread(function: Callable[P, T]) -> Callable[P, T]:
    """Runs a function with one BLAS thread; calls inside each other cost nothing more."""

    @functools.wraps(function)
    def limited(*arguments: P.args, **options: P.kwargs) -> T:
        global _depth
        if _depth:
            return function(*arguments, **options)
        _depth += 1
        try:
            with _controller().limit(limits=1):
                return function(*arguments, **options)
        finally:
            _depth -= 1

    return limited
