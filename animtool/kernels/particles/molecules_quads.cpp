// Forces between molecules for processors with registers of four doubles; the build says where
// the compiler may use them, and the processor is asked before it runs.
#include "base/quads.h"
#include "particles/molecules_lanes.h"

namespace animtool {

#ifdef ANIMTOOL_QUADS

MoleculeFunction molecules_in_quads() {
  return has_quads() ? MoleculeLoops<QuadRows>::run : nullptr;
}

#else

MoleculeFunction molecules_in_quads() { return nullptr; }

#endif

}  // namespace animtool
