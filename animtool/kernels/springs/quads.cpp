// Springs four at a time for processors with registers of four doubles; the build says
// where the compiler may use them, and the processor is asked before it runs.
#include "base/quads.h"
#include "springs/bands.h"
#include "springs/bundle.h"
#include "springs/rows.h"

namespace animtool {

#ifdef ANIMTOOL_QUADS

AddPulls add_pulls_in_quads() {
  return has_quads() ? add_pulls<QuadRows> : nullptr;
}

PlaneLoops plane_loops_here() {
  return has_quads() ? plane_loops<QuadRows>() : plane_loops<PlainRows>();
}

AccelerateRows accelerate_rows_in_quads() {
  return has_quads() ? accelerate_rows<QuadRows> : nullptr;
}

AdvanceRows advance_rows_in_quads() {
  return has_quads() ? advance_rows<QuadRows> : nullptr;
}

ProjectAll project_all_in_quads() {
  return has_quads() ? project_all<QuadRows> : nullptr;
}

CrossBundle cross_bundle_in_quads() {
  return has_quads() ? cross_bundle<QuadRows> : nullptr;
}

#else

AddPulls add_pulls_in_quads() { return nullptr; }

PlaneLoops plane_loops_here() { return plane_loops<PlainRows>(); }

CrossBundle cross_bundle_in_quads() { return nullptr; }

AccelerateRows accelerate_rows_in_quads() { return nullptr; }

AdvanceRows advance_rows_in_quads() { return nullptr; }

ProjectAll project_all_in_quads() { return nullptr; }

#endif

}  // namespace animtool
