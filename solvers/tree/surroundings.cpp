#include "solvers/tree/surroundings.h"

namespace sekitei::tree {
}  // namespace sekitei::tree
