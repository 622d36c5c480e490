"""The words in which annotations of arrays are written: ``Float[np.ndarray, "rows k"]``.

They are jaxtyping's for type checkers, and where it has been loaded before Eivor, as the tests do to check
every annotation. Elsewhere nobody reads annotations, and loading it is a thirtieth of `eivor identify`: there
the same words stand for arrays of any shape.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING or "jaxtyping" in sys.modules:
    from jaxtyping import Bool, Complex, Float, Int
else:

    class _Unchecked:
        def __class_getitem__(cls, kind_and_shape: tuple[Any, str]) -> Any:
            """Kind of array, whatever its shape."""
            return kind_and_shape[0]

    Bool = Complex = Float = Int = _Unchecked

__all__ = ["Bool", "Complex", "Float", "Int"]
