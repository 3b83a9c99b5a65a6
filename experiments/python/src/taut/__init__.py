"""taut: characterisation and calibration of soft-rigid robot modules.

    import taut

    e = taut.Experiment("experiments/foam_cantilever/experiment.toml")
    e.readings                                # what was measured, in SI
    run = e.fit(out="runs/foam_cantilever")   # as `taut fit`
    run.parameters["E_foam"].value            # [Pa]
    run.predict([{"tip_load": 3.0}])          # at loads that nobody has measured, with 95 % bands

Numbers are in SI everywhere; tables say their units in ``table.attrs["units"]``. What computes does so on threads of its
own, without Python's lock. Ctrl-C ends it soon: KeyboardInterrupt, whose attribute ``result`` is what was finished, or
None. Wrong input raises InputError, a simulation without an equilibrium SolveError.

`Run` reads folders that `taut fit` wrote and needs nothing compiled; all else needs the module ``taut._taut``.
"""

from .errors import InputError, SolveError
from .experiment import Experiment
from .run import Parameter, Run
from .simulation import InverseKinematics, Pose, Simulation, ik, simulate

__all__ = ["Experiment", "InputError", "InverseKinematics", "Parameter", "Pose", "Run", "Simulation", "SolveError",
           "ik", "simulate"]


def __getattr__(name: str) -> str:
    if name == "__version__":
        from .compiled import module

        return module().version
    raise AttributeError(f"module 'taut' has no attribute '{name}'")
