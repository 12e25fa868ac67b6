// Density contributions of walls and other colliders to a fluid.
#include "fluid/fluid.h"

#include <algorithm>

namespace animtool::fluid {

using collide::Collider;
using collide::Pose;
using collide::Sample;
using collide::Shape;

namespace {

// Zeros of a Legendre polynomial, and the Gauss weights, on [0, 1].
template <int N>
void compute_gauss_nodes(double* nodes, double* weights) {
  for (int i = 0; i < N; ++i) {
    double x = std::cos(3.14159265358979323846 * (i + 0.75) / (N + 0.5)), derivative = 1;
    for (int iteration = 0; iteration < 50; ++iteration) {
      double p = 1, previous = 0;
      for (int k = 1; k <= N; ++k) {
        const double next = ((2 * k - 1) * x * p - (k - 1) * previous) / k;
        previous = p, p = next;
      }
      derivative = N * (x * p - previous) / (x * x - 1);
      x -= p / derivative;
    }
    nodes[i] = (1 + x) / 2;
    weights[i] = 1 / ((1 - x * x) * derivative * derivative);
  }
}

// Calls a function for each point of a lattice around a particle, with its distance in radii.
template <class Function>
void for_each_lattice_point(Function function) {
  const int max_index = static_cast<int>(std::ceil(RADIUS_RATIO));
  for (int x = -max_index; x <= max_index; ++x)
    for (int y = -max_index; y <= max_index; ++y)
      for (int z = -max_index; z <= max_index; ++z)
        function(x, y, std::sqrt(static_cast<double>(x * x + y * y + z * z)) / RADIUS_RATIO);
}

// Sum of weights over the lattice points whose first coordinates are negative: of none, one or two
// coordinates.
double half_lattice_sum(int coordinates) {
  double sum = 0;
  for_each_lattice_point([&](int x, int y, double q) {
    const int coordinate = coordinates > 1 ? std::max(x, y) : coordinates > 0 ? x : -1;
    if (q < 1 && coordinate < 0) sum += Kernel::weight(q);
  });
  return sum;
}

}  // namespace

double Walls::lattice_weight_sum() { return half_lattice_sum(0); }

double Walls::lattice_steepness() {
  double sum = 0;
  for_each_lattice_point([&](int, int, double q) {
    const double derivative = q < 1 ? Kernel::derivative_over_q(q) : 0.0;
    sum += derivative * derivative;
  });
  return sum / (half_lattice_sum(0) * half_lattice_sum(0));
}

double Walls::virial() {
  double sum = 0;
  for_each_lattice_point([&](int x, int, double q) {
    if (x < 0 && q < 1) sum -= Kernel::derivative_over_q(q) * q / 3;
  });
  return sum / half_lattice_sum(1);
}

Walls::Walls() {
  compute_gauss_nodes<SHELL_COUNT>(radii_, weights_);
  const double wall = half_lattice_sum(1), edge = half_lattice_sum(2);
  // At an edge, both walls overlap in the same corner, whose product counts once.
  full_density_ = wall * wall / edge;
  // A lattice wall contributes what the replaced layers would contribute.
  double low = 0.5, high = 2, value, derivative;
  for (int iteration = 0; iteration < 60; ++iteration) {
    scale_ = (low + high) / 2;
    integrate(0.5 / RADIUS_RATIO, 0, value, derivative);
    (value > wall / full_density_ ? low : high) = scale_;
  }
  for (int i = 0; i < TABLE_KNOTS; ++i)
    integrate(2.0 * i / (TABLE_KNOTS - 1) - 1, 0, plane_table_[i][0], plane_table_[i][1]);
}

// Integrates over shells around the particle: the surface cuts each in a circle.
void Walls::integrate(double distance, double unscaled_curvature, double& value,
                      double& derivative) const {
  const double scaled_distance = std::clamp(distance * scale_, -1.0, 1.0),
               curvature = unscaled_curvature / scale_, inner_radius = std::fabs(scaled_distance),
               thickness = 1 - inner_radius;
  // 1 / integral of the weight over the ball.
  const double normalisation = 210.0 / 23;
  value = derivative = 0;
  const double scale_factor = std::max(1 + curvature * scaled_distance, 1e-3);
  for (int i = 0; i < SHELL_COUNT; ++i) {
    const double r = inner_radius + thickness * radii_[i];
    const double shell_integral =
        4 * r * r * Kernel::weight(r) * weights_[i] * thickness * normalisation;
    const double numerator =
                     2 * scaled_distance + curvature * (scaled_distance * scaled_distance + r * r),
                 denominator = 2 * r * scale_factor;
    const double cosine = numerator / denominator;
    if (cosine >= 1) continue;
    value += shell_integral * (1 - std::max(cosine, -1.0)) / 2;
    if (cosine > -1)
      derivative -= shell_integral *
                    ((2 + 2 * curvature * scaled_distance) / denominator -
                     cosine * curvature / scale_factor) /
                    2;
  }
  if (scaled_distance < 0)  // shells that are entirely beyond the surface
    for (int i = 0; i < SHELL_COUNT; ++i) {
      const double r = inner_radius * radii_[i];
      value += 4 * r * r * Kernel::weight(r) * weights_[i] * inner_radius * normalisation;
    }
  derivative *= scale_;
}

void Walls::fraction(double distance, double curvature, double& value, double& derivative) const {
  if (distance >= 1) {
    value = derivative = 0;
    return;
  }
  if (curvature != 0) return integrate(distance, curvature, value, derivative);
  const double table_position = (std::max(distance, -1.0) + 1) * ((TABLE_KNOTS - 1) / 2);
  const int knot = std::min(static_cast<int>(table_position), TABLE_KNOTS - 2);
  const double fraction = table_position - knot;
  value = plane_table_[knot][0] * (1 - fraction) + plane_table_[knot + 1][0] * fraction;
  derivative = plane_table_[knot][1] * (1 - fraction) + plane_table_[knot + 1][1] * fraction;
}

const Walls& walls() {
  static const Walls walls_table;
  return walls_table;
}

namespace {

double mean_curvature(const Collider& c) {
  double radius = 0;
  if (c.shape == Shape::SPHERE) radius = c.size[3];
  // The mean curvature of a cylinder is half that of a ball.
  if (c.shape == Shape::CAPSULE) radius = 2 * c.size[6];
  return radius > 0 ? 1 / (c.is_container ? -radius : radius) : 0.0;
}

// Moving fluid layers are less dense than a lattice: the gap to a wall, and to a body that the
// fluid flows around, is larger by this, in radii.
double layer_gap(const Collider& c) {
  return (c.is_container || c.shape == Shape::PLANE ? WALL_GAP : BODY_GAP) / RADIUS_RATIO;
}

// The contribution of a box. It presses through the nearest face; changes of the fraction along a
// face would make the box appear wider.
void box_contribution(const Collider& c, const Pose& pose, Vec point, double radius,
                      WallContribution& out) {
  const Vec local = pose.to_local(point);
  const double coordinates[3] = {local.x, local.y, local.z};
  double overlaps[3], derivatives[3];
  for (int k = 0; k < 3; ++k) {
    const double half_extent =
        std::max(c.size[k] + (layer_gap(c) * radius - c.margin) * (c.is_container ? 1 : -1), 0.0);
    double high, low, high_derivative, low_derivative;
    walls().fraction((half_extent - coordinates[k]) / radius, 0, high, high_derivative);
    walls().fraction((half_extent + coordinates[k]) / radius, 0, low, low_derivative);
    overlaps[k] = std::max(1 - high - low, 0.0);
    derivatives[k] = (high_derivative - low_derivative) / radius;
  }
  const Vec gradient{derivatives[0] * overlaps[1] * overlaps[2],
                     overlaps[0] * derivatives[1] * overlaps[2],
                     overlaps[0] * overlaps[1] * derivatives[2]};
  const double product = overlaps[0] * overlaps[1] * overlaps[2];
  out.fraction = c.is_container ? 1 - product : product;
  out.gradient = pose.rotate(c.is_container ? -gradient : gradient);
  const auto is_outside = [&](int k) { return std::fabs(coordinates[k]) > c.size[k] ? 1.0 : 0.0; };
  const Vec pressing_gradient{gradient.x * is_outside(0), gradient.y * is_outside(1),
                              gradient.z * is_outside(2)};
  out.pressing_gradient = c.is_container ? out.gradient : pose.rotate(pressing_gradient);
}

}  // namespace

// The contribution of any collider.
WallContribution wall_contribution(const Collider& c, const Pose& pose, Vec point, double radius) {
  const Sample sample = collide::sample(c, pose, point, 0, radius);
  WallContribution out;
  out.distance = sample.distance, out.normal = sample.normal;
  if (!(sample.distance < radius)) return out;
  if (c.shape == Shape::BOX) {
    box_contribution(c, pose, point, radius, out);
    return out;
  }
  double derivative;
  walls().fraction(sample.distance / radius + layer_gap(c), mean_curvature(c) * radius,
                   out.fraction, derivative);
  out.gradient = out.pressing_gradient = sample.normal * (derivative / radius);
  return out;
}

}  // namespace animtool::fluid
