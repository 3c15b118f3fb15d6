#include "solvers/tree/crown_light.h"

namespace sekitei::tree {
}  // namespace sekitei::tree
