// Functions on many springs, four at a time, compiled for several processors.
#pragma once

#include "base/quads.h"
#include "springs/bands.h"
#include "springs/bundle.h"
#include "springs/rows.h"

namespace animtool {

// The functions that are compiled for one type of processor.
struct SpringFunctions {
  void (*add_forces)(const SpringColumns&, std::size_t, const double*, const double*, double*);
  void (*accelerate)(const ParticleColumns&, std::size_t, const double*, const double*, double*);
  void (*advance)(std::size_t, double, const double*, double*, double*);
  void (*project)(const ComplianceColumns&, const SpringRunLength*, std::size_t, double*,
                  const double*, double*);
  // Conversion between rows and planes, and functions on planes.
  void (*to_planes)(const double* rows, std::size_t count, std::size_t height, double* planes);
  void (*to_rows)(const double* planes, std::size_t count, std::size_t height, double* rows);
  void (*add_plane_forces)(const BandChunks&, const BandPlanes&);
  void (*step_planes)(const BandChunks&, const PlaneSteps&, const BandPlanes&);
  void (*advance_bundle)(const StrandSteps&, StrandBundle&);
};

template <class Simd>
constexpr SpringFunctions spring_functions_on{
    add_forces<Simd>,       accelerate_rows<Simd>, advance_rows<Simd>,
    project_all<Simd>,      rows_to_planes<Simd>,  planes_to_rows<Simd>,
    add_plane_forces<Simd>, step_planes<Simd>,     advance_bundle<Simd>};

const SpringFunctions* springs_in_quads();  // null if the processor has no such registers
const SpringFunctions& spring_functions();  // those for this processor

}  // namespace animtool
