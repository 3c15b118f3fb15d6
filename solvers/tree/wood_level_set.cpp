#include "solvers/tree/wood.h"

namespace sekitei::tree {
}  // namespace sekitei::tree
