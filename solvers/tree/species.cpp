#include "solvers/tree/species.h"

namespace sekitei::tree {

void validate(const Species& species)
{
    validate_described("tree", species);
}

}  // namespace sekitei::tree
