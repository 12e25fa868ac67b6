// Untangling of self-intersecting surfaces.
#include "springs/intersections.h"

#include <algorithm>
#include <cmath>

#include "springs/grid.h"
#include "springs/separation.h"

namespace animtool {

using collide::load;
using collide::store;
using collide::Vec;

double find_intersection(const shapes::Segment& edge, const shapes::Triangle& t) {
  const Vec normal = cross(t.b - t.a, t.c - t.a);
  const double start_height = dot(edge.a - t.a, normal), end_height = dot(edge.b - t.a, normal);
  if (!(start_height * end_height < 0)) return -1;
  const double fraction = start_height / (start_height - end_height);
  const Vec point = edge.point_at(fraction);
  const auto is_left = [&](Vec from, Vec to) {
    return dot(cross(to - from, point - from), normal) > 0;
  };
  return is_left(t.a, t.b) && is_left(t.b, t.c) && is_left(t.c, t.a) ? fraction : -1;
}

std::vector<EdgeIntersection> find_intersections(const std::vector<double>& x,
                                                 const std::vector<std::int32_t>& ends,
                                                 const std::vector<std::int32_t>& corners) {
  const std::size_t edge_count = ends.size() / 2;
  std::vector<EdgeIntersection> intersections;
  std::vector<double> midpoints(PARTICLE_STRIDE * edge_count);
  double max_length = 0, length_sum = 0;
  const auto segment = [&](std::size_t e) { return shapes::Segment(&ends[2 * e], x.data()); };
  for (std::size_t e = 0; e < edge_count; ++e) {
    store(segment(e).point_at(0.5), &midpoints[PARTICLE_STRIDE * e]);
    const double edge_length = length(segment(e).vector());
    max_length = std::max(max_length, edge_length), length_sum += edge_length;
  }
  if (!(length_sum > 0)) return intersections;
  PointGrid grid;
  grid.build(midpoints.data(), edge_count, length_sum / static_cast<double>(edge_count));
  for (std::size_t t = 0; t < corners.size(); t += 3) {
    const shapes::Triangle triangle(&corners[t], x.data());
    double low[3], high[3];
    for (std::size_t k = 0; k < 3; ++k) {
      const auto coordinate = [&](std::size_t i) {
        return x[PARTICLE_STRIDE * static_cast<std::size_t>(corners[t + i]) + k];
      };
      low[k] = std::min({coordinate(0), coordinate(1), coordinate(2)}) - max_length / 2;
      high[k] = std::max({coordinate(0), coordinate(1), coordinate(2)}) + max_length / 2;
    }
    grid.visit(low, high, [&](std::int32_t e, const double*) {
      const std::int32_t* edge_ends = &ends[2 * static_cast<std::size_t>(e)];
      for (std::size_t k = t; k < t + 3; ++k)
        if (corners[k] == edge_ends[0] || corners[k] == edge_ends[1]) return;
      if (find_intersection(segment(static_cast<std::size_t>(e)), triangle) >= 0)
        intersections.push_back({e, static_cast<std::int32_t>(t / 3)});
    });
  }
  return intersections;
}

IntersectionResolver::IntersectionResolver(const SpringLayers& layers,
                                           const std::vector<double>& inverse_masses)
    : layers_(layers),
      inverse_masses_(inverse_masses),
      opposite_corners_(layers.edge_count(), {-1, -1}),
      is_intersecting_(layers.particle_count(), 0) {
  for (std::size_t e = 0; e < layers.edge_count(); ++e)
    ends_.insert(ends_.end(), layers.ends(e), layers.ends(e) + 2);
  for (std::size_t t = 0; t < layers.triangle_count(); ++t)
    triangles_.insert(triangles_.end(), layers.corners(t), layers.corners(t) + 3);
  for (std::size_t t = 0; t < triangles_.size(); t += 3)
    for (std::size_t k = 0; k < 3; ++k) {
      const auto [i, j] = std::minmax(triangles_[t + k], triangles_[t + (k + 1) % 3]);
      // Edges are sorted by their ends.
      std::size_t low = 0, high = layers.edge_count();
      while (low < high) {
        const std::size_t middle = (low + high) / 2;
        if (std::pair(ends_[2 * middle], ends_[2 * middle + 1]) < std::pair(i, j))
          low = middle + 1;
        else
          high = middle;
      }
      auto& opposite = opposite_corners_[low];
      opposite[opposite[0] < 0 ? 0 : 1] = triangles_[t + (k + 2) % 3];
    }
}

void IntersectionResolver::find(const std::vector<double>& x) {
  if (has_intersections()) std::fill(is_intersecting_.begin(), is_intersecting_.end(), 0);
  intersections_ = find_intersections(x, ends_, triangles_);
  for (const EdgeIntersection& intersection : intersections_) {
    const std::int32_t* ends = layers_.ends(static_cast<std::size_t>(intersection.edge));
    const std::int32_t* corners = layers_.corners(static_cast<std::size_t>(intersection.triangle));
    for (std::size_t k = 0; k < 2; ++k) is_intersecting_[static_cast<std::size_t>(ends[k])] = 1;
    for (std::size_t k = 0; k < 3; ++k) is_intersecting_[static_cast<std::size_t>(corners[k])] = 1;
  }
}

Vec IntersectionResolver::shortening_direction(const EdgeIntersection& intersection,
                                               const std::vector<double>& x) const {
  const auto e = static_cast<std::size_t>(intersection.edge);
  const shapes::Segment edge(layers_.ends(e), x.data());
  const shapes::Triangle triangle(layers_.corners(static_cast<std::size_t>(intersection.triangle)),
                                  x.data());
  const Vec normal = triangle.normal(), edge_direction = collide::direction(edge.vector(), Vec{});
  const double normal_component = dot(edge_direction, normal);
  Vec direction_sum;
  for (const std::int32_t corner : opposite_corners_[e]) {
    if (corner < 0) continue;
    const Vec offset = shapes::position_of(x.data(), corner) - edge.a;
    const Vec inward = offset - edge_direction * dot(offset, edge_direction);
    Vec contour_direction = collide::direction(cross(cross(edge_direction, inward), normal), Vec{});
    if (dot(contour_direction, inward) < 0) contour_direction = -contour_direction;
    // The intersection point slides along the edge, so that it stays in the plane of the triangle.
    direction_sum = direction_sum + contour_direction -
                    normal * (dot(contour_direction, edge_direction) / normal_component);
  }
  return collide::direction(direction_sum, Vec{});
}

void IntersectionResolver::resolve(double distance, std::vector<double>& before,
                                   std::vector<double>& x) const {
  for (const EdgeIntersection& intersection : intersections_) {
    const std::int32_t* ends = layers_.ends(static_cast<std::size_t>(intersection.edge));
    const std::int32_t* corners = layers_.corners(static_cast<std::size_t>(intersection.triangle));
    const shapes::Segment edge(ends, x.data());
    const shapes::Triangle triangle(corners, x.data());
    const double fraction = find_intersection(edge, triangle);
    if (fraction < 0) continue;
    const Vec direction = shortening_direction(intersection, x);
    if (!(dot(direction, direction) > 0)) continue;
    const shapes::Nearest nearest = triangle.nearest(edge.point_at(fraction));
    const std::int32_t particles[5] = {ends[0], ends[1], corners[0], corners[1], corners[2]};
    const double coefficients[5] = {1 - fraction, fraction, nearest.coefficients[1],
                                    nearest.coefficients[2], nearest.coefficients[3]};
    double total_weight = 0, max_inverse_mass = 0;
    for (std::size_t k = 0; k < 5; ++k) {
      const double inverse_mass = inverse_masses_[static_cast<std::size_t>(particles[k])];
      total_weight += inverse_mass * coefficients[k] * coefficients[k];
      max_inverse_mass = std::max(max_inverse_mass, inverse_mass);
    }
    total_weight = std::max(total_weight, max_inverse_mass / MAX_SHIFT_RATIO);
    if (!(total_weight > 0)) continue;
    for (std::size_t k = 0; k < 5; ++k) {
      const auto n = static_cast<std::size_t>(particles[k]);
      const Vec correction =
          direction * (distance * inverse_masses_[n] * coefficients[k] / total_weight);
      store(load(&x[PARTICLE_STRIDE * n]) + correction, &x[PARTICLE_STRIDE * n]);
      store(load(&before[PARTICLE_STRIDE * n]) + correction, &before[PARTICLE_STRIDE * n]);
    }
  }
}

}  // namespace animtool
