#include "solvers/tree/shape.h"

namespace sekitei::tree {
}  // namespace sekitei::tree
