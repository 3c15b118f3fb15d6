#include "solvers/tree/grove.h"

namespace sekitei::tree {
}  // namespace sekitei::tree
