// Particles of springs against colliders, at the end of each short step.
#pragma once

#include <vector>

#include "collide.h"
#include "kernels.h"
#include "springs.h"

namespace animtool {

// Colliders, their poses at both ends of each cell (cells, C, 2, 7), and the distance that
// particles keep.
using SpringColliders = std::tuple<ColliderArrays, In<double, 4>, double>;

std::vector<collide::Collider> read_colliders(const ColliderArrays& arrays);

class SpringContacts {
 public:
  SpringContacts(const std::optional<SpringColliders>& colliders, std::size_t particles,
                 std::int64_t cells);

  bool any() const { return !colliders_.empty(); }
  // A cell of time begins; its steps are even.
  void begin_cell(std::int64_t cell, int substeps);
  // Moves particles out of what they are in at the end of a step of a cell, and takes what
  // friction does from their way; with velocities, from these too. Returns whether any was
  // moved.
  bool settle(const SpringNetwork& network, int step, double h,
              const std::vector<double>& before, std::vector<double>& x,
              std::vector<double>* v);
  // Particles that were left inside at the end of a cell, at most.
  std::int64_t unresolved = 0;

 private:
  bool settle_one(double inverse_h, double h, const double* before, double* x, double* v,
                  bool& left_inside);
  bool push(std::size_t c, double h, collide::Vec before, collide::Vec& x, double* v,
            bool& left_inside);
  void measure(std::size_t n, const double* x);

  std::vector<collide::Collider> colliders_;
  std::vector<collide::Motion> whole_;
  const double* poses_ = nullptr;
  double radius_ = 0;
  int substeps_ = 1;
  std::int64_t last_ = -1;
  // How far each particle is from all colliders at least, and what turns reach it by.
  std::vector<double> clear_, arm_;
};

}  // namespace animtool
