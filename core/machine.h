#pragma once

/// What this machine has.
namespace sekitei {

/// Memory that this process may use: the machine's, or less where its own limit (`ulimit -v`) says
/// so [bytes].
double physical_memory();

}  // namespace sekitei
