// The joints that move a goal, and where they stand.
#pragma once

#include <vector>

#include "ik/driver.h"

namespace animtool::ik {

enum class Kind { PIN = 0, SLIDE = 1, BALL = 2 };

// A moving joint. A pin turns about its own z, a slide goes along it, and z is the
// twist axis of a ball; whoever builds the chain turns the frames so. Several
// nodes may follow one coordinate: value = gain * coordinate + shift.
struct Node {
  Kind kind;
  int parent;         // -1 for one that hangs on the world
  double rest[9];     // parent_from_node
  double offset[3];   // of its origin, in the parent's frame
  double gain, shift;  // of pins and slides
  bool follows;       // the coordinate belongs to an earlier node, or a program is followed
  double limit[4];    // low, high; of a ball swing about x, swing about y, twist low, high
  double quick[5];    // of the limits of a ball, see prepare
  int coordinate;     // first of 1 or 4
  int dof;            // first of 1 or 3
  int program;        // that gives the value in place of a coordinate, or -1

  int width() const { return kind == Kind::BALL ? 3 : 1; }
};

struct Chain {
  std::vector<Node> nodes;
  std::vector<Program> programs;  // each behind those whose results it reads
  int coordinates = 0;
  int dofs = 0;
};

// World frames of the nodes after their own motion, and the axes that they move about.
struct Frames {
  std::vector<double> rotations;  // (N, 3, 3)
  std::vector<double> origins;    // (N, 3)
  std::vector<double> axes;       // (N, 3, 3), one a row; the first only of pins and slides
  Results results;                // of the chain's programs

  explicit Frames(const Chain& chain)
      : rotations(9 * chain.nodes.size()), origins(3 * chain.nodes.size()),
        axes(9 * chain.nodes.size()) {
    std::size_t room = 0, slopes = 0;
    for (const Program& program : chain.programs) {
      room = std::max(room, program.depth * (1 + program.dofs.size()));
      slopes += program.dofs.size();
    }
    results.values.resize(chain.programs.size());
    results.slopes.resize(slopes);
    results.stack.resize(room);
  }
};

// Calls `use(k, dof, gain)` for each axis k of a node and what moves it: `gain` times the
// degree of freedom, to first order.
template <class Use>
void each_slope(const Chain& chain, const Node& node, const Frames& frames, Use&& use) {
  if (node.program < 0) {
    for (int k = 0; k < node.width(); ++k) use(k, node.dof + k, node.gain);
    return;
  }
  const Program& program = chain.programs[node.program];
  for (std::size_t s = 0; s < program.dofs.size(); ++s)
    use(0, program.dofs[s], node.gain * frames.results.slopes[program.first + s]);
}

// Calls `use(dof)` for what moves a node.
template <class Use>
void each_dof(const Chain& chain, const Node& node, Use&& use) {
  if (node.program < 0)
    for (int d = node.dof; d < node.dof + node.width(); ++d) use(d);
  else
    for (const int d : chain.programs[node.program].dofs) use(d);
}

inline void turn_about_z(const double* r, double angle, double* out) {
  const double c = std::cos(angle), s = std::sin(angle);
  for (int i = 0; i < 9; i += 3) {
    out[i] = c * r[i] + s * r[i + 1];
    out[i + 1] = c * r[i + 1] - s * r[i];
    out[i + 2] = r[i + 2];
  }
}

// Of the nodes from `first` to before `end`, those before them being known.
inline void forward(const Chain& chain, const double* q, std::size_t first, std::size_t end,
                    Frames& frames) {
  if (!chain.programs.empty()) Evaluation(chain.programs, q, frames.results).run();
  for (std::size_t n = first; n < end; ++n) {
    const Node& node = chain.nodes[n];
    double still[9];
    double* origin = &frames.origins[3 * n];
    double* rotation = &frames.rotations[9 * n];
    double* axes = &frames.axes[9 * n];
    if (node.parent < 0) {
      std::copy(node.rest, node.rest + 9, still);
      std::copy(node.offset, node.offset + 3, origin);
    } else {
      const double* parent = &frames.rotations[9 * node.parent];
      const double* base = &frames.origins[3 * node.parent];
      multiply(parent, node.rest, still);
      rotate(parent, node.offset, origin);
      for (int i = 0; i < 3; ++i) origin[i] += base[i];
    }
    const double* own = q + node.coordinate;
    if (node.kind == Kind::BALL) {
      double motion[9];
      to_matrix(own, motion);
      multiply(still, motion, rotation);
      for (int i = 0; i < 9; ++i) axes[3 * (i % 3) + i / 3] = still[i];
      continue;
    }
    const double by = node.program < 0 ? own[0] : frames.results.values[node.program];
    const double value = node.gain * by + node.shift;
    for (int i = 0; i < 3; ++i) axes[i] = still[3 * i + 2];
    if (node.kind == Kind::PIN) {
      turn_about_z(still, value, rotation);
    } else {
      std::copy(still, still + 9, rotation);
      for (int i = 0; i < 3; ++i) origin[i] += axes[i] * value;
    }
  }
}

inline void forward(const Chain& chain, const double* q, Frames& frames) {
  forward(chain, q, 0, chain.nodes.size(), frames);
}

// How a point and a frame carried by a node move with one of its axes.
inline void velocity(const Node& node, const double* axis, const double* origin,
                     const double* point, double* linear, double* angular) {
  if (node.kind == Kind::SLIDE) {
    for (int i = 0; i < 3; ++i) linear[i] = axis[i], angular[i] = 0;
    return;
  }
  const double arm[3] = {point[0] - origin[0], point[1] - origin[1], point[2] - origin[2]};
  cross(axis, arm, linear);
  for (int i = 0; i < 3; ++i) angular[i] = axis[i];
}

}  // namespace animtool::ik
