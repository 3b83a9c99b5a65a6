#pragma once
#include "calib/studies/crew.hpp"

namespace taut {

/// This process's place among those that mpirun started together; null: it was started alone. Throws InputError where
/// there are several and this taut was built without MPI (-DTAUT_MPI=ON): each would do the whole work.
Messages* mpi_messages();

/// Says to the others that it is over, and leaves them. To be called once before the process ends, with its exit code;
/// returns that code.
int leave_mpi(int code);

}  // namespace taut
