// Collisions of edges and faces of surfaces with fine collider features.
#include "springs/faces.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "springs/contacts.h"

namespace animtool {

namespace {

using collide::boxes_overlap;
using collide::Collider;
using collide::curvature_radius;
using collide::load;
using collide::max_of;
using collide::Mesh;
using collide::min_of;
using collide::Shape;
using collide::store;
using collide::Vec;
using shapes::position_of;

// No point of an edge that is stretched to twice its length is farther than this from both of its
// ends [longest rest edge].
constexpr double EDGE_REACH_FACTOR = 1.2;
// Smallest distance from lines without thickness [longest rest edge].
constexpr double MIN_CONTACT_DISTANCE = 1e-3;
// Contact searches in a step, and iterations of resolving contacts.
constexpr int MAX_CONTACT_SEARCHES = 2, MAX_ITERATIONS = 6;

// The corners and edges of a box.
FineFeatures box_features(const double* half_extents) {
  FineFeatures features;
  for (int k = 0; k < 8; ++k)
    features.points.push_back({k & 1 ? half_extents[0] : -half_extents[0],
                               k & 2 ? half_extents[1] : -half_extents[1],
                               k & 4 ? half_extents[2] : -half_extents[2]});
  for (std::int32_t k = 0; k < 8; ++k)
    for (const std::int32_t axis : {1, 2, 4})
      if (!(k & axis)) features.lines.push_back({k, k | axis});
  return features;
}

// The sharp edges of a mesh and their ends.
FineFeatures mesh_features(const Collider& c, double longest_edge, double distance) {
  FineFeatures features;
  std::vector<std::array<std::int32_t, 4>> sharp_sides;  // two points, triangle, side
  std::int32_t triangles = 0;
  const Vec infinite_extent{collide::INF, collide::INF, collide::INF};
  collide::visit_overlapping(
      c.mesh, c.mesh_root, -infinite_extent, infinite_extent, [&](std::int32_t t) {
        triangles = std::max(triangles, t + 1);
        for (std::int32_t side = 0; side < 3; ++side) {
          if (!(curvature_radius(c.mesh, t, side, longest_edge) + distance < longest_edge))
            continue;
          const std::int32_t* corner = c.mesh.triangles + 3 * t;
          const auto [i, j] = std::minmax(corner[side], corner[(side + 1) % 3]);
          sharp_sides.push_back({i, j, t, side});
        }
      });
  std::sort(sharp_sides.begin(), sharp_sides.end());
  std::vector<std::int32_t> points;
  for (const auto& side : sharp_sides) points.insert(points.end(), {side[0], side[1]});
  std::sort(points.begin(), points.end());
  points.erase(std::unique(points.begin(), points.end()), points.end());
  for (const std::int32_t p : points) features.points.push_back(c.mesh.point(p));
  const auto point_index = [&](std::int32_t p) {
    return static_cast<std::int32_t>(std::lower_bound(points.begin(), points.end(), p) -
                                     points.begin());
  };
  if (sharp_sides.empty()) return features;
  features.triangle_features.assign(static_cast<std::size_t>(triangles), {-1, -1, -1, -1, -1, -1});
  for (const auto& [i, j, t, side] : sharp_sides) {
    const std::array<std::int32_t, 2> line{point_index(i), point_index(j)};
    if (features.lines.empty() || features.lines.back() != line) features.lines.push_back(line);
    auto& entry = features.triangle_features[static_cast<std::size_t>(t)];
    const auto k = static_cast<std::size_t>(side);
    entry[k] = static_cast<std::int32_t>(features.lines.size()) - 1;
    const std::int32_t* corner = c.mesh.triangles + 3 * t;
    entry[3 + k] = point_index(corner[k]);
    entry[3 + (k + 1) % 3] = point_index(corner[(k + 1) % 3]);
  }
  return features;
}

// The features of a collider that are finer than the longest edge of a surface.
FineFeatures collider_features(const Collider& c, double radius, double longest_edge) {
  if (c.is_container) return {};
  const double distance = collide::contact_distance(c, radius);
  FineFeatures features;
  switch (c.shape) {
    case Shape::PLANE:
      return {};
    case Shape::SPHERE:
      if (!(c.size[3] + distance < longest_edge)) return {};
      features.points = {load(c.size)};
      features.radius = c.size[3] + distance;
      return features;
    case Shape::CAPSULE:
      if (!(c.size[6] + distance < longest_edge)) return {};
      features.points = {load(c.size), load(c.size + 3)};
      features.lines = {{0, 1}};
      features.radius = c.size[6] + distance;
      return features;
    case Shape::BOX:
      features = box_features(c.size);
      break;
    case Shape::MESH:
      features = mesh_features(c, longest_edge, distance);
      break;
  }
  features.radius = std::max(distance, MIN_CONTACT_DISTANCE * longest_edge);
  features.is_built = true;
  return features;
}

}  // namespace

FaceContacts::FaceContacts(const SpringElements& elements, double radius)
    : network_(elements),
      radius_(radius),
      search_distance_(EDGE_REACH_FACTOR * elements.longest_edge) {}

void FaceContacts::add(const Collider& c) {
  // Features of meshes are searched only near elements.
  const bool is_deferred = c.shape == Shape::MESH && !c.is_container;
  features_.emplace_back();
  if (network_.edges.empty()) return;
  if (!is_deferred) features_.back() = collider_features(c, radius_, network_.longest_edge);
  features_.back().is_built = !is_deferred;
  has_features_ |= is_deferred || features_.back().has_points();
  if (!has_features_ || !slot_of_particle_.empty()) return;
  slot_of_particle_.assign(network_.particle_count(), -1);
  is_candidate_.assign(network_.particle_count(), 0);
}

bool FaceContacts::resolve(std::size_t index, const StepCollider& c, double h,
                           const std::vector<std::int32_t>& near_particles, StepState state) {
  moved_particles.clear();
  if (index >= features_.size()) return false;
  FineFeatures& features = features_[index];
  if (!features.is_built && may_touch_any(c, near_particles, state))
    features = collider_features(c.collider, radius_, network_.longest_edge);
  if (!features.has_points()) return false;
  if (!collect_elements(features, c, near_particles, state)) return false;
  uncorrected_from_ = from_, uncorrected_to_ = to_;
  Separation separation(c.collider.friction, c.collider.depenetration * h, inverse_masses_, from_,
                        to_, true);
  bool has_contacts = false;
  for (int search = 0; search < MAX_CONTACT_SEARCHES; ++search) {
    find_contacts(features, c);
    if (edge_hits_.empty() && corner_hits_.empty()) break;
    has_contacts = true;
    int iterations = 1;
    while (separate(separation) && iterations < MAX_ITERATIONS) ++iterations;
    // Elements that moved little make no new contacts.
    if (iterations == 1) break;
  }
  if (has_contacts) {
    separation.finish();
    write_back(c, h, state);
    has_contacts = !moved_particles.empty();
  }
  for (const std::int32_t n : particle_of_slot_)
    if (n >= 0) slot_of_particle_[static_cast<std::size_t>(n)] = -1;
  return has_contacts;
}

// Whether a point may touch the features of a collider; for a box its edges, for a mesh its bounds.
static bool may_touch(const FineFeatures& features, const Collider& c, Vec p, double max_distance) {
  if (c.shape == Shape::BOX) {
    const double distances[3] = {std::abs(p.x) - c.size[0], std::abs(p.y) - c.size[1],
                                 std::abs(p.z) - c.size[2]};
    int near_faces = 0;
    for (const double distance : distances) {
      if (distance > max_distance) return false;
      near_faces += distance >= -max_distance;
    }
    return near_faces >= 2;
  }
  if (c.shape == Shape::MESH)
    return collide::squared_box_distance(p, c.mesh.bounds + 6 * c.mesh_root) <=
           max_distance * max_distance;
  const Vec a = features.points.front(), b = features.points.back();
  return boxes_overlap(p, p, min_of(a, b), max_of(a, b), max_distance);
}

bool FaceContacts::may_touch_any(const StepCollider& c,
                                 const std::vector<std::int32_t>& near_particles,
                                 const StepState& state) const {
  const double max_distance = search_distance_ + collide::contact_distance(c.collider, radius_);
  return std::any_of(near_particles.begin(), near_particles.end(), [&](std::int32_t n) {
    const Vec start = c.begin.to_local(position_of(state.before.data(), n));
    const Vec end = c.end.to_local(position_of(state.x.data(), n));
    return may_touch({}, c.collider, end, max_distance + length(end - start));
  });
}

bool FaceContacts::collect_elements(const FineFeatures& features, const StepCollider& c,
                                    const std::vector<std::int32_t>& near_particles,
                                    const StepState& state) {
  from_.clear();
  to_.clear();
  particle_of_slot_.clear();
  inverse_masses_.clear();
  elements_.clear();
  std::vector<std::int32_t> candidates;
  for (const std::int32_t n : near_particles) {
    const Vec from = c.begin.to_local(position_of(state.before.data(), n));
    const Vec to = c.end.to_local(position_of(state.x.data(), n));
    if (!may_touch(features, c.collider, to,
                   search_distance_ + features.radius + length(to - from)))
      continue;
    candidates.push_back(n);
    is_candidate_[static_cast<std::size_t>(n)] = 1;
  }
  if (candidates.empty()) return false;
  const auto add_all = [&](const std::vector<std::int32_t>& corners, int count) {
    for (std::size_t k = 0; k < corners.size(); k += static_cast<std::size_t>(count))
      if (std::any_of(&corners[k], &corners[k] + count,
                      [&](std::int32_t n) { return is_candidate_[static_cast<std::size_t>(n)]; }))
        add_element(&corners[k], count, c, state);
  };
  add_all(network_.edges, 2);
  add_all(network_.triangles, 3);
  for (const std::int32_t n : candidates) is_candidate_[static_cast<std::size_t>(n)] = 0;
  for (const Vec p : features.points) {
    const double row[PARTICLE_STRIDE] = {p.x, p.y, p.z, 0};
    from_.insert(from_.end(), row, row + PARTICLE_STRIDE);
    to_.insert(to_.end(), row, row + PARTICLE_STRIDE);
    inverse_masses_.push_back(0);
  }
  return true;
}

std::int32_t FaceContacts::find_or_add_slot(std::int32_t particle, const StepCollider& c,
                                            const StepState& state) {
  std::int32_t& entry = slot_of_particle_[static_cast<std::size_t>(particle)];
  if (entry >= 0) return entry;
  entry = static_cast<std::int32_t>(particle_of_slot_.size());
  particle_of_slot_.push_back(particle);
  inverse_masses_.push_back(network_.inverse_masses[static_cast<std::size_t>(particle)]);
  from_.resize(from_.size() + PARTICLE_STRIDE, 0.0);
  to_.resize(to_.size() + PARTICLE_STRIDE, 0.0);
  store(c.begin.to_local(position_of(state.before.data(), particle)),
        &from_[from_.size() - PARTICLE_STRIDE]);
  store(c.end.to_local(position_of(state.x.data(), particle)), &to_[to_.size() - PARTICLE_STRIDE]);
  return entry;
}

void FaceContacts::add_element(const std::int32_t* corners, int count, const StepCollider& c,
                               const StepState& state) {
  Element element{{}, count, {}, {}};
  for (int k = 0; k < count; ++k)
    element.corners[static_cast<std::size_t>(k)] = find_or_add_slot(corners[k], c, state);
  elements_.push_back(element);
}

// Number of axes along which an element is near a face of a box: two at edges, three at corners.
static int count_near_axes(const double* half_extents, Vec low, Vec high, double distance) {
  const double low_corner[3] = {low.x, low.y, low.z}, high_corner[3] = {high.x, high.y, high.z};
  int count = 0;
  for (int k = 0; k < 3; ++k)
    count += (low_corner[k] <= half_extents[k] + distance &&
              high_corner[k] >= half_extents[k] - distance) ||
             (low_corner[k] <= -half_extents[k] + distance &&
              high_corner[k] >= -half_extents[k] - distance);
  return count;
}

void FaceContacts::find_contacts(const FineFeatures& features, const StepCollider& c) {
  edge_hits_.clear();
  corner_hits_.clear();
  for (Element& element : elements_) {
    element.low = {collide::INF, collide::INF, collide::INF}, element.high = -element.low;
    for (int k = 0; k < element.count; ++k)
      for (const auto* positions : {&from_, &to_}) {
        const Vec point =
            position_of(positions->data(), element.corners[static_cast<std::size_t>(k)]);
        element.low = min_of(element.low, point), element.high = max_of(element.high, point);
      }
  }
  const auto point_count = static_cast<std::int32_t>(features.points.size());
  const auto line_count = static_cast<std::int32_t>(features.lines.size());
  std::vector<std::int32_t> feature_indices;
  for (const Element& element : elements_) {
    if (c.collider.shape == Shape::BOX &&
        count_near_axes(c.collider.size, element.low, element.high, features.radius) <
            element.count)
      continue;
    if (features.triangle_features.empty()) {
      for (std::int32_t k = 0; k < (element.count == 2 ? line_count : point_count); ++k)
        add_contacts(features, element, k);
      continue;
    }
    const Vec margin{features.radius, features.radius, features.radius};
    const std::size_t first = element.count == 2 ? 0 : 3;
    feature_indices.clear();
    collide::visit_overlapping(c.collider.mesh, c.collider.mesh_root, element.low - margin,
                               element.high + margin, [&](std::int32_t t) {
                                 const auto& entry =
                                     features.triangle_features[static_cast<std::size_t>(t)];
                                 for (std::size_t k = first; k < first + 3; ++k)
                                   if (entry[k] >= 0) feature_indices.push_back(entry[k]);
                               });
    std::sort(feature_indices.begin(), feature_indices.end());
    feature_indices.erase(std::unique(feature_indices.begin(), feature_indices.end()),
                          feature_indices.end());
    for (const std::int32_t k : feature_indices) add_contacts(features, element, k);
  }
}

void FaceContacts::add_contacts(const FineFeatures& features, const Element& element,
                                std::int32_t feature) {
  const auto first_point = static_cast<std::int32_t>(particle_of_slot_.size());
  const auto index = static_cast<std::size_t>(feature);
  if (element.count == 3) {
    const Vec p = features.points[index];
    if (boxes_overlap(p, p, element.low, element.high, features.radius))
      add_pair<shapes::CornerPair>(
          {first_point + feature, element.corners[0], element.corners[1], element.corners[2]},
          features.radius);
    return;
  }
  const auto [i, j] = features.lines[index];
  const Vec a = features.points[static_cast<std::size_t>(i)];
  const Vec b = features.points[static_cast<std::size_t>(j)];
  if (boxes_overlap(min_of(a, b), max_of(a, b), element.low, element.high, features.radius))
    add_pair<shapes::EdgePair>(
        {element.corners[0], element.corners[1], first_point + i, first_point + j},
        features.radius);
}

template <class Shape>
void FaceContacts::add_pair(const FourParticles& particles, double distance) {
  const Shape current(particles.data(), to_.data());
  double travel = 0;
  for (const std::int32_t n : particles)
    travel = std::max(travel, length(position_of(to_.data(), n) - position_of(from_.data(), n)));
  const shapes::Nearest nearest = current.nearest();
  const double gap = length(nearest.offset);
  if (!(gap < distance + travel)) return;
  LayerHit hit{0, 0, 0, particles, gap, travel, distance};
  if (gap <= travel)
    hit.side = shapes::crossing_side(Shape(particles.data(), from_.data()), current);
  if (!hit.side && !nearest.is_interior) return;
  (std::is_same_v<Shape, shapes::EdgePair> ? edge_hits_ : corner_hits_).push_back(hit);
}

bool FaceContacts::separate(Separation& separation) const {
  bool has_separated = false;
  for (const LayerHit& hit : corner_hits_)
    has_separated |= separation.separate<shapes::CornerPair>(hit);
  for (const LayerHit& hit : edge_hits_)
    has_separated |= separation.separate<shapes::EdgePair>(hit);
  return has_separated;
}

void FaceContacts::write_back(const StepCollider& c, double h, StepState& state) {
  for (std::size_t k = 0; k < particle_of_slot_.size(); ++k) {
    const Vec end_shift =
        load(&to_[PARTICLE_STRIDE * k]) - load(&uncorrected_to_[PARTICLE_STRIDE * k]);
    const Vec start_shift =
        load(&from_[PARTICLE_STRIDE * k]) - load(&uncorrected_from_[PARTICLE_STRIDE * k]);
    if (dot(end_shift, end_shift) == 0 && dot(start_shift, start_shift) == 0) continue;
    const std::int32_t n = particle_of_slot_[k];
    const std::size_t row = PARTICLE_STRIDE * static_cast<std::size_t>(n);
    const Vec end_change = c.end.rotate(end_shift), start_change = c.begin.rotate(start_shift);
    store(load(&state.x[row]) + end_change, &state.x[row]);
    store(load(&state.before[row]) + start_change, &state.before[row]);
    const Vec velocity_change = (end_change - start_change) * (1 / h);
    if (state.v) store(load(&(*state.v)[row]) + velocity_change, &(*state.v)[row]);
    moved_particles.push_back({n, length(end_change) + length(start_change), velocity_change});
  }
}

}  // namespace animtool
