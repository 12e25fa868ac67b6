// The forces of springs on particles.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "springs_bands.h"
#include "springs_rows.h"

namespace animtool {

struct Spring {
  std::int32_t i, j;
  double rest, stiffness, damping, limit;  // limit: the length at which it tears
};

// Room for the forces of one run.
struct PullRoom {
  std::vector<double> x, v, f;
};

// What forces need to know of springs: in bands where many lie alike, the others in fours.
class SpringPulls {
 public:
  SpringPulls() = default;
  SpringPulls(const std::vector<Spring>& springs, std::size_t particles);

  // Set rows of particles to the forces [N] on them.
  void set(const double* x, const double* v, PullRoom& room, double* forces) const;

 private:
  struct Numbers {
    std::vector<double> rest, stiffness, damping;

    void add(double length, double stiff, double damps);
  };

  std::vector<std::size_t> lay_bands(const std::vector<Spring>& springs);
  void lay_band(const std::vector<Spring>& springs, const std::size_t* chosen,
                std::size_t count);

  std::size_t particles_ = 0;
  std::vector<SpringBand> bands_;
  Numbers banded_, loose_;
  std::vector<std::int32_t> loose_ends_;
};

}  // namespace animtool
