// Density contributions of walls and other colliders to a fluid.
#include "fluid/fluid.h"

#include <algorithm>

namespace animtool::fluid {

using collide::Collider;
using collide::Pose;
using collide::Sample;
using collide::Shape;

namespace {

// Zeros of a Legendre polynomial and their weights, on [0, 1].
template <int N>
void gauss(double* at, double* weight) {
  for (int i = 0; i < N; ++i) {
    double x = std::cos(3.14159265358979323846 * (i + 0.75) / (N + 0.5)), slope = 1;
    for (int round = 0; round < 50; ++round) {
      double p = 1, before = 0;
      for (int k = 1; k <= N; ++k) {
        const double next = ((2 * k - 1) * x * p - (k - 1) * before) / k;
        before = p, p = next;
      }
      slope = N * (x * p - before) / (x * x - 1);
      x -= p / slope;
    }
    at[i] = (1 + x) / 2;
    weight[i] = 1 / ((1 - x * x) * slope * slope);
  }
}

// Visits each point of a lattice around one, with its distance in radii.
template <class Act>
void each_point(Act act) {
  const int reach = static_cast<int>(std::ceil(REACH));
  for (int x = -reach; x <= reach; ++x)
    for (int y = -reach; y <= reach; ++y)
      for (int z = -reach; z <= reach; ++z)
        act(x, y, std::sqrt(static_cast<double>(x * x + y * y + z * z)) / REACH);
}

// Sum of weights over lattice points whose first coordinates are negative.
double lattice_beyond(int coordinates) {
  double sum = 0;
  each_point([&](int x, int y, double q) {
    const int below = coordinates > 1 ? std::max(x, y) : coordinates > 0 ? x : -1;
    if (q < 1 && below < 0) sum += Weight::at(q);
  });
  return sum;
}

}  // namespace

double Walls::lattice() { return lattice_beyond(0); }

double Walls::steepness() {
  double sum = 0;
  each_point([&](int, int, double q) {
    const double slope = q < 1 ? Weight::slope(q) : 0.0;
    sum += slope * slope;
  });
  return sum / (lattice_beyond(0) * lattice_beyond(0));
}

double Walls::virial() {
  double sum = 0;
  each_point([&](int x, int, double q) {
    if (x < 0 && q < 1) sum -= Weight::slope(q) * q / 3;
  });
  return sum / lattice_beyond(1);
}

Walls::Walls() {
  gauss<SHELLS>(radii_, weights_);
  const double wall = lattice_beyond(1), edge = lattice_beyond(2);
  // At an edge both walls overlap in the same corner: their product counts once.
  full_ = wall * wall / edge;
  // A lattice wall contributes what the replaced layers would.
  double low = 0.5, high = 2, value, slope;
  for (int round = 0; round < 60; ++round) {
    scale_ = (low + high) / 2;
    integral(0.5 / REACH, 0, value, slope);
    (value > wall / full_ ? low : high) = scale_;
  }
  for (int i = 0; i < KNOTS; ++i) integral(2.0 * i / (KNOTS - 1) - 1, 0, flat_[i][0], flat_[i][1]);
}

// Integrates over shells around the particle: the surface cuts each in a circle.
void Walls::integral(double distance, double curved, double& value, double& slope) const {
  const double d = std::clamp(distance * scale_, -1.0, 1.0), curvature = curved / scale_,
               from = std::fabs(d), span = 1 - from;
  // 1 / integral of the weight over the ball.
  const double norm = 210.0 / 23;
  value = slope = 0;
  const double stretch = std::max(1 + curvature * d, 1e-3);
  for (int i = 0; i < SHELLS; ++i) {
    const double r = from + span * radii_[i];
    const double shell = 4 * r * r * Weight::at(r) * weights_[i] * span * norm;
    const double numerator = 2 * d + curvature * (d * d + r * r), denominator = 2 * r * stretch;
    const double cosine = numerator / denominator;
    if (cosine >= 1) continue;
    value += shell * (1 - std::max(cosine, -1.0)) / 2;
    if (cosine > -1)
      slope -= shell * ((2 + 2 * curvature * d) / denominator - cosine * curvature / stretch) / 2;
  }
  if (d < 0)  // shells entirely beyond it
    for (int i = 0; i < SHELLS; ++i) {
      const double r = from * radii_[i];
      value += 4 * r * r * Weight::at(r) * weights_[i] * from * norm;
    }
  slope *= scale_;
}

void Walls::fraction(double distance, double curvature, double& value, double& slope) const {
  if (distance >= 1) {
    value = slope = 0;
    return;
  }
  if (curvature != 0) return integral(distance, curvature, value, slope);
  const double at = (std::max(distance, -1.0) + 1) * ((KNOTS - 1) / 2);
  const int knot = std::min(static_cast<int>(at), KNOTS - 2);
  const double fraction = at - knot;
  value = flat_[knot][0] * (1 - fraction) + flat_[knot + 1][0] * fraction;
  slope = flat_[knot][1] * (1 - fraction) + flat_[knot + 1][1] * fraction;
}

const Walls& walls() {
  static const Walls walls_table;
  return walls_table;
}

namespace {

double curvature(const Collider& c) {
  double radius = 0;
  if (c.shape == Shape::SPHERE) radius = c.size[3];
  // The mean curvature of a cylinder is half that of a ball.
  if (c.shape == Shape::CAPSULE) radius = 2 * c.size[6];
  return radius > 0 ? 1 / (c.container ? -radius : radius) : 0.0;
}

// Moving fluid layers are looser than a lattice: the gap to a wall, and to a body it flows around,
// is larger by this, in radii.
double layer_gap(const Collider& c) {
  return (c.container || c.shape == Shape::PLANE ? WALL_GAP : BODY_GAP) / REACH;
}

// A box presses through the nearest face; changes of the fraction along a face would make it wider.
void box_contribution(const Collider& c, const Pose& pose, Vec point, double radius,
                      WallContribution& out) {
  const Vec local = pose.to_local(point);
  const double at[3] = {local.x, local.y, local.z};
  double inside[3], slopes[3];
  for (int k = 0; k < 3; ++k) {
    const double half =
        std::max(c.size[k] + (layer_gap(c) * radius - c.margin) * (c.container ? 1 : -1), 0.0);
    double high, low, falls, rises;
    walls().fraction((half - at[k]) / radius, 0, high, falls);
    walls().fraction((half + at[k]) / radius, 0, low, rises);
    inside[k] = std::max(1 - high - low, 0.0);
    slopes[k] = (falls - rises) / radius;
  }
  const Vec slope{slopes[0] * inside[1] * inside[2], inside[0] * slopes[1] * inside[2],
                  inside[0] * inside[1] * slopes[2]};
  const double product = inside[0] * inside[1] * inside[2];
  out.fraction = c.container ? 1 - product : product;
  out.slope = pose.rotated(c.container ? -slope : slope);
  const auto before = [&](int k) { return std::fabs(at[k]) > c.size[k] ? 1.0 : 0.0; };
  const Vec push{slope.x * before(0), slope.y * before(1), slope.z * before(2)};
  out.push = c.container ? out.slope : pose.rotated(push);
}

}  // namespace

WallContribution wall_contribution(const Collider& c, const Pose& pose, Vec point, double radius) {
  const Sample sample = collide::sample(c, pose, point, 0, radius);
  WallContribution out;
  out.distance = sample.distance, out.normal = sample.normal;
  if (!(sample.distance < radius)) return out;
  if (c.shape == Shape::BOX) {
    box_contribution(c, pose, point, radius, out);
    return out;
  }
  double slope;
  walls().fraction(sample.distance / radius + layer_gap(c), curvature(c) * radius, out.fraction,
                   slope);
  out.slope = out.push = sample.normal * (slope / radius);
  return out;
}

}  // namespace animtool::fluid
