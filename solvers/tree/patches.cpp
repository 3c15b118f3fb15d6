#include "solvers/tree/patches.h"

namespace sekitei::tree {
}  // namespace sekitei::tree
