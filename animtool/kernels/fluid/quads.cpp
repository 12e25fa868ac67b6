// Interactions of neighbours in a fluid, for processors with registers of four doubles.
#include "base/quads.h"
#include "fluid/lanes.h"

namespace animtool {

const FluidFunctions* fluid_in_quads() {
  return has_quads() ? &FluidKernels<Quads>::functions : nullptr;
}

}  // namespace animtool
