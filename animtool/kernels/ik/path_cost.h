// What a path of poses costs: its distance from another, its speed and its acceleration.
#pragma once

#include <cstddef>
#include <vector>

#include "ik/band.h"
#include "ik/tangent.h"

namespace animtool::ik {

// Sums anchor |q - anchor|^2 + speed |v|^2 + acceleration |a|^2, halved, over the frames. Of
// balls, differences are rotation vectors.
class PathCost {
 public:
  // What the acceleration at each frame costs.
  std::vector<double> bends;

  // `drifts` (F - 1, D) is the motion from frame to frame that costs nothing; null is none.
  PathCost(const Chain& chain, int frames, const PathWeights& weights, const double* drifts)
      : chain_(chain), frames_(frames), width_(chain.dofs), weights_(weights), drifts_(drifts),
        away_(chain.dofs), still_(chain.dofs, 0.0) {}

  // Of a path (F, Q), and its gradient (F, D) where one is asked for.
  double evaluate(const double* anchors, const double* q, std::vector<double>* slope = nullptr) {
    const std::size_t size = static_cast<std::size_t>(frames_) * width_;
    speeds_.resize(size), forces_.resize(size);
    if (slope) slope->assign(size, 0.0);
    double cost = 0;
    for (int t = 0; t < frames_ && weights_.anchor > 0; ++t) {
      difference(chain_, anchors + at(t), q + at(t), away_.data());
      for (int d = 0; d < width_; ++d) {
        cost += weights_.anchor * away_[d] * away_[d] / 2;
        if (slope) (*slope)[row(t) + d] += weights_.anchor * away_[d];
      }
    }
    std::fill(forces_.begin(), forces_.end(), 0.0);
    bends.assign(frames_, 0.0);
    for (int t = 0; t + 1 < frames_; ++t) {
      double *speed = speeds_.data() + row(t), *force = forces_.data() + row(t);
      difference(chain_, q + at(t), q + at(t + 1), speed);
      const double* drift = drift_of(t);
      const double* before = t > 0 ? drift_of(t - 1) : nullptr;
      for (int d = 0; d < width_; ++d) {
        const double u = speed[d] - drift[d];
        cost += weights_.speed * u * u / 2;
        force[d] += weights_.speed * u;
        if (t == 0) continue;
        const double a = u - (speed[d - width_] - before[d]);
        bends[t] += weights_.acceleration * a * a / 2;
        force[d] += weights_.acceleration * a;
        force[d - width_] -= weights_.acceleration * a;
      }
    }
    for (const double bend : bends) cost += bend;
    if (slope)
      for (int t = 0; t + 1 < frames_; ++t) spread(t, *slope);
    return cost;
  }

 private:
  std::size_t at(int t) const { return static_cast<std::size_t>(t) * chain_.coordinates; }
  std::size_t row(int t) const { return static_cast<std::size_t>(t) * width_; }
  const double* drift_of(int t) const { return drifts_ ? drifts_ + row(t) : still_.data(); }

  // What pulls at the motion from one frame to the next pulls at both poses.
  void spread(int t, std::vector<double>& slope) const {
    const double *speed = speeds_.data() + row(t), *force = forces_.data() + row(t);
    double *now = slope.data() + row(t), *next = slope.data() + row(t + 1);
    for (const Node& node : chain_.nodes) {
      if (node.follows) continue;
      const int d = node.dof;
      double back[3] = {-force[d]}, on[3] = {force[d]};
      if (node.kind == Kind::BALL) {
        pull_back(speed + d, force + d, 1, on);
        pull_back(speed + d, force + d, -1, back);
        for (double& x : back) x = -x;
      }
      for (int k = 0; k < node.width(); ++k) now[d + k] += back[k], next[d + k] += on[k];
    }
  }

  const Chain& chain_;
  const int frames_, width_;
  const PathWeights weights_;
  const double* drifts_;
  std::vector<double> speeds_, forces_, away_, still_;
};

}  // namespace animtool::ik
