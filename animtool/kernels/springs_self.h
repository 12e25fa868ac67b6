// Surfaces of springs that keep apart from themselves.
//
// M. Müller et al., Position Based Dynamics, 2007, 3.5 and 4.4 (particles against triangles,
// each on the side that it was); R. Bridson et al., Robust Treatment of Collisions, Contact
// and Friction for Cloth Animation, 2002, 7 (thickness and friction).
#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "springs.h"

namespace animtool {

// Particles in cells of a grid, found by their cell's hash; those of a cell ascend.
class ParticleGrid {
 public:
  void build(const double* rows, std::size_t count, double cell);

  // Calls with each particle that may lie in a box, and its place.
  template <class Function>
  void visit(const double* low, const double* high, Function function) const;

 private:
  std::uint64_t key(const std::int64_t* cell) const;
  std::size_t bucket(std::uint64_t key) const;
  std::int64_t cell_of(double place, std::size_t axis) const;

  std::size_t count_ = 0, mask_ = 0;
  double low_[3] = {0, 0, 0}, over_ = 1;
  std::vector<std::uint32_t> starts_;
  std::vector<std::uint64_t> keys_;
  std::vector<std::int32_t> particles_;
  std::vector<double> places_;  // as the rows, sorted
};

// What of such a surface does not change: how far who keeps from whom.
class SpringLayers {
 public:
  // Rest: where particles are at rest (N, 3). Speed: with which what is nearer than it may
  // be at the start comes apart.
  SpringLayers(const SpringNetwork& network, In<double, 2> rest, double thickness,
               double friction, double speed);

  std::size_t particles() const { return particles_; }
  std::size_t triangles() const { return corners_.size() / 3; }
  const std::int32_t* corners(std::size_t triangle) const { return &corners_[3 * triangle]; }
  // Distance that a particle keeps from a triangle, 0 of those that the springs keep apart.
  double least(std::size_t triangle, std::int32_t particle) const;

  const double thickness, friction, speed;

 private:
  void note_neighbours(const SpringNetwork& network, const std::vector<double>& rest);
  void note_near(const std::vector<double>& rest);

  std::size_t particles_;
  std::vector<std::int32_t> corners_;
  // Of each triangle, particles that are left to springs, and those that are nearer at rest
  // than the thickness, with their distance.
  std::vector<std::size_t> neighbour_starts_;
  std::vector<std::int32_t> neighbours_;
  std::vector<std::vector<std::pair<std::int32_t, double>>> near_;
};

// A particle that went through a triangle, and the side of it (1 or -1) that it came from.
struct Passage {
  std::int32_t particle, triangle, side;

  bool operator==(const Passage&) const = default;
};

// The contacts of a surface with itself, over the steps of a run.
class SelfContacts {
 public:
  SelfContacts(const SpringLayers& layers, const SpringNetwork& network);
  // Without layers nothing is done. Crossed: passages to go on with (C, 3), as `ended` returns them.
  SelfContacts(const SpringLayers* layers, const SpringNetwork& network,
               const In<std::int64_t, 2>& crossed);

  // A cell of time begins; one that began before is crossed again.
  void begin_cell(std::int64_t cell);
  // Moves particles apart at the end of a step; where they only come back to the distance
  // that they are to keep, what they were before moves too, so that it gives no speed.
  void keep_apart(double h, std::vector<double>& before, std::vector<double>& x);
  // Notes who is on another side than at the begin of the step.
  void look(const std::vector<double>& before, const std::vector<double>& x);

  // Particle, triangle and side of each passage that is left (C, 3).
  Out<std::int64_t, 2> ended() const;
  // How many particles went through.
  std::int64_t particles_passed() const;

 private:
  struct Candidate {
    std::int32_t particle, triangle;
    double least;
    float gap;
  };
  struct Hit {
    std::int32_t particle, triangle, side;
    double apart, travel, least;
  };

  bool measure(double h, const std::vector<double>& before, const std::vector<double>& x);
  void list(const std::vector<double>& x);
  void find_hits(double h, const std::vector<double>& before, const std::vector<double>& x);
  std::int32_t side_of(const Hit& hit, const std::vector<double>& before,
                       const std::vector<double>& x) const;
  double way(std::int32_t particle) const { return ways_[static_cast<std::size_t>(particle)]; }
  bool came_round(const Hit& hit) const;
  void part(const Hit& hit, double h, const std::vector<double>& before,
            std::vector<double>& x);

  const SpringLayers* layers_;
  const SpringNetwork& network_;
  std::vector<Passage> crossed_, begun_;
  std::int64_t cell_ = -1;

  ParticleGrid grid_;
  std::vector<Candidate> candidates_;
  std::vector<double> listed_at_;  // rows
  double listed_ = -1;             // up to which distance
  double travel_ = 0, drift_ = 0, reach_ = 0;  // of any pair, at most
  std::vector<double> ways_;                   // of particles in the step, over that of all

  std::vector<Hit> hits_;
  std::vector<Passage> flagged_;  // by particle
  std::vector<double> shifted_;   // before, with what gives no speed
  bool shifts_ = false;           // whether there is such
};

}  // namespace animtool
