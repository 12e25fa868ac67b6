// What neighbours in a fluid do to each other, for processors with registers of four doubles;
// the build says where the compiler may use them, and the processor is asked before it runs.
#include "base/quads.h"
#include "fluid/lanes.h"

namespace animtool {

#ifdef ANIMTOOL_QUADS

const FluidFunctions* fluid_in_quads() {
  return has_quads() ? &FluidLoops<QuadRows>::functions : nullptr;
}

#else

const FluidFunctions* fluid_in_quads() { return nullptr; }

#endif

}  // namespace animtool
