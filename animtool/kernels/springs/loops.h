// Loops over springs, four at a time, in versions for several processors.
#pragma once

#include "base/quads.h"
#include "springs/bands.h"
#include "springs/bundle.h"
#include "springs/rows.h"

namespace animtool {

struct SpringLoops {
  void (*add_forces)(const SpringColumns&, std::size_t, const double*, const double*, double*);
  void (*accelerate)(const ParticleColumns&, std::size_t, const double*, const double*, double*);
  void (*advance)(std::size_t, double, const double*, double*, double*);
  void (*project)(const ComplianceColumns&, const SpringRunLength*, std::size_t, double*,
                  const double*, double*);
  // Conversion between rows and planes, and loops over planes.
  void (*to_planes)(const double* rows, std::size_t count, std::size_t height, double* planes);
  void (*to_rows)(const double* planes, std::size_t count, std::size_t height, double* rows);
  void (*pull_planes)(const BandPieces&, const BandPlanes&);
  void (*step_planes)(const BandPieces&, const PlaneSteps&, const BandPlanes&);
  void (*advance_bundle)(const StrandSteps&, StrandBundle&);
};

template <class On>
constexpr SpringLoops spring_loops_on{add_forces<On>,  accelerate_rows<On>, advance_rows<On>,
                                      project_all<On>, rows_to_planes<On>,  planes_to_rows<On>,
                                      pull_planes<On>, step_planes<On>,     advance_bundle<On>};

const SpringLoops* springs_in_quads();  // null where the processor has no such registers
const SpringLoops& spring_loops();      // those for this processor

}  // namespace animtool
