"""Symmetric sparse systems: MKL's pardiso where it can be imported, else scipy's LU."""

import numpy as np
import scipy.sparse as sp

try:
    from pypardiso import PyPardisoSolver
except ImportError:
    PyPardisoSolver = None


class Factor:
    """A factor of a symmetric matrix given by its upper triangle (CSR)."""

    def __init__(self):
        self._pardiso = PyPardisoSolver(mtype=-2) if PyPardisoSolver else None
        self._upper = None
        self._lu = None

    def update(self, upper):
        """Factor anew; the pattern is that of before."""
        self._upper = upper
        if self._pardiso is None:
            full = upper + sp.triu(upper, 1).T
            self._lu = sp.linalg.splu(full.tocsc(), options={"SymmetricMode": True}, diag_pivot_thresh=0.01)
            return
        rhs = np.zeros(upper.shape[0])
        self._pardiso.set_phase(12 if self._lu is None else 22)
        self._pardiso._call_pardiso(upper, rhs)
        self._lu = True

    def solve(self, rhs):
        """Return the solution."""
        if self._pardiso is None:
            return self._lu.solve(rhs)
        self._pardiso.set_phase(33)
        return self._pardiso._call_pardiso(self._upper, np.ascontiguousarray(rhs))

    def free(self):
        """Give back the memory."""
        if self._pardiso is not None:
            self._pardiso.free_memory(everything=True)
