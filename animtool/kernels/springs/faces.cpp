// Edges and faces of surfaces against fine collider features.
#include "springs/faces.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "springs/contacts.h"

namespace animtool {

namespace {

using collide::Collider;
using collide::load;
using collide::Mesh;
using collide::Shape;
using collide::store;
using collide::Vec;
using shapes::row_of;

// No point of an edge that is stretched to twice its length is farther than this from both ends
// [longest rest edge].
constexpr double NEAR = 1.2;
// Smallest distance kept from lines without thickness [longest rest edge].
constexpr double MIN_DISTANCE = 1e-3;
// Angle below which neighbouring faces of boxes and meshes count as flat [rad].
constexpr double FLAT = 1e-3;
// Contact searches in a step, and iterations of resolving contacts.
constexpr int MAX_SEARCHES = 2, MAX_ITERATIONS = 6;

Vec min_of(Vec a, Vec b) { return {std::min(a.x, b.x), std::min(a.y, b.y), std::min(a.z, b.z)}; }
Vec max_of(Vec a, Vec b) { return {std::max(a.x, b.x), std::max(a.y, b.y), std::max(a.z, b.z)}; }
// Whether boxes are at most this far apart along each axis.
bool overlap(Vec low, Vec high, Vec other_low, Vec other_high, double reach) {
  return low.x <= other_high.x + reach && high.x >= other_low.x - reach &&
         low.y <= other_high.y + reach && high.y >= other_low.y - reach &&
         low.z <= other_high.z + reach && high.z >= other_low.z - reach;
}

FineFeatures box_features(const double* half) {
  FineFeatures features;
  for (int k = 0; k < 8; ++k)
    features.points.push_back(
        {k & 1 ? half[0] : -half[0], k & 2 ? half[1] : -half[1], k & 4 ? half[2] : -half[2]});
  for (std::int32_t k = 0; k < 8; ++k)
    for (const std::int32_t axis : {1, 2, 4})
      if (!(k & axis)) features.lines.push_back({k, k | axis});
  return features;
}

// Radius of curvature of a mesh at the edge of a triangle: infinite if it is flat or concave, and
// at most that of faces as wide as a length.
double edge_radius(const Mesh& mesh, std::int32_t triangle, int side, double widest) {
  const std::int32_t* corner = mesh.triangles + 3 * triangle;
  const Vec a = mesh.point(corner[side]), b = mesh.point(corner[(side + 1) % 3]);
  const Vec opposite = mesh.point(corner[(side + 2) % 3]) - a, along = b - a;
  const double squared = dot(along, along);
  if (!(squared > 0)) return collide::FAR;
  const Vec inward = opposite - along * (dot(opposite, along) / squared);
  const Vec sum = load(mesh.edge_normals + 9 * triangle + 3 * side);
  // On the boundary of an open mesh.
  if (dot(sum, sum) == 0) return 0;
  if (!(dot(sum, inward) < -FLAT * FLAT * length(inward))) return collide::FAR;
  const Vec normal = collide::face_normal(mesh, triangle, {});
  const double angle = 2 * std::atan2(length(cross(normal, sum)), dot(normal, sum));
  return angle > FLAT ? std::min(length(inward), widest) / angle : collide::FAR;
}

FineFeatures mesh_features(const Collider& c, double longest, double distance) {
  FineFeatures features;
  std::vector<std::array<std::int32_t, 4>> touches;  // both ends, triangle, side
  std::int32_t triangles = 0;
  const Vec all{collide::FAR, collide::FAR, collide::FAR};
  collide::visit_overlapping(c.mesh, c.root, -all, all, [&](std::int32_t t) {
    triangles = std::max(triangles, t + 1);
    for (std::int32_t side = 0; side < 3; ++side) {
      if (!(edge_radius(c.mesh, t, side, longest) + distance < longest)) continue;
      const std::int32_t* corner = c.mesh.triangles + 3 * t;
      const auto [i, j] = std::minmax(corner[side], corner[(side + 1) % 3]);
      touches.push_back({i, j, t, side});
    }
  });
  std::sort(touches.begin(), touches.end());
  std::vector<std::int32_t> points;
  for (const auto& one : touches) points.insert(points.end(), {one[0], one[1]});
  std::sort(points.begin(), points.end());
  points.erase(std::unique(points.begin(), points.end()), points.end());
  for (const std::int32_t p : points) features.points.push_back(c.mesh.point(p));
  const auto number = [&](std::int32_t p) {
    return static_cast<std::int32_t>(std::lower_bound(points.begin(), points.end(), p) -
                                     points.begin());
  };
  if (touches.empty()) return features;
  features.of_triangle.assign(static_cast<std::size_t>(triangles), {-1, -1, -1, -1, -1, -1});
  for (const auto& [i, j, t, side] : touches) {
    const std::array<std::int32_t, 2> line{number(i), number(j)};
    if (features.lines.empty() || features.lines.back() != line) features.lines.push_back(line);
    auto& entry = features.of_triangle[static_cast<std::size_t>(t)];
    const auto k = static_cast<std::size_t>(side);
    entry[k] = static_cast<std::int32_t>(features.lines.size()) - 1;
    const std::int32_t* corner = c.mesh.triangles + 3 * t;
    entry[3 + k] = number(corner[k]);
    entry[3 + (k + 1) % 3] = number(corner[(k + 1) % 3]);
  }
  return features;
}

// The features of a collider that are finer than the longest edge of a surface.
FineFeatures collider_features(const Collider& c, double radius, double longest) {
  if (c.container) return {};
  const double distance = collide::contact_distance(c, radius);
  FineFeatures features;
  switch (c.shape) {
    case Shape::PLANE:
      return {};
    case Shape::SPHERE:
      if (!(c.size[3] + distance < longest)) return {};
      features.points = {load(c.size)};
      features.radius = c.size[3] + distance;
      return features;
    case Shape::CAPSULE:
      if (!(c.size[6] + distance < longest)) return {};
      features.points = {load(c.size), load(c.size + 3)};
      features.lines = {{0, 1}};
      features.radius = c.size[6] + distance;
      return features;
    case Shape::BOX:
      features = box_features(c.size);
      break;
    case Shape::MESH:
      features = mesh_features(c, longest, distance);
      break;
  }
  features.radius = std::max(distance, MIN_DISTANCE * longest);
  features.is_built = true;
  return features;
}

}  // namespace

FaceContacts::FaceContacts(const SpringElements& elements, double radius)
    : network_(elements), radius_(radius), reach_(NEAR * elements.longest_edge) {}

void FaceContacts::add(const Collider& c) {
  // Features of meshes are searched only near elements.
  const bool later = c.shape == Shape::MESH && !c.container;
  features_.emplace_back();
  if (network_.edges.empty()) return;
  if (!later) features_.back() = collider_features(c, radius_, network_.longest_edge);
  features_.back().is_built = !later;
  any_ |= later || features_.back().any();
  if (!any_ || !slots_.empty()) return;
  slots_.assign(network_.particles(), -1);
  marked_.assign(network_.particles(), 0);
}

bool FaceContacts::resolve(std::size_t index, const StepCollider& c, double h,
                           const std::vector<std::int32_t>& near, StepRows rows) {
  moved.clear();
  if (index >= features_.size()) return false;
  FineFeatures& features = features_[index];
  if (!features.is_built && is_near(c, near, rows))
    features = collider_features(c.collider, radius_, network_.longest_edge);
  if (!features.any()) return false;
  if (!collect_elements(features, c, near, rows)) return false;
  start_ = from_, end_ = to_;
  Separation separation(c.collider.friction, c.collider.depenetration * h, inverse_masses_, from_,
                        to_, true);
  bool has_contacts = false;
  for (int search = 0; search < MAX_SEARCHES; ++search) {
    find_contacts(features, c);
    if (edges_.empty() && corners_.empty()) break;
    has_contacts = true;
    int iterations = 1;
    while (separate(separation) && iterations < MAX_ITERATIONS) ++iterations;
    // Elements that moved little make no new contacts.
    if (iterations == 1) break;
  }
  if (has_contacts) {
    separation.end();
    write(c, h, rows);
    has_contacts = !moved.empty();
  }
  for (const std::int32_t n : particles_)
    if (n >= 0) slots_[static_cast<std::size_t>(n)] = -1;
  return has_contacts;
}

// Whether a point may touch features of a collider; for a box: its edges.
static bool may_touch(const FineFeatures& features, const Collider& c, Vec p, double reach) {
  if (c.shape == Shape::BOX) {
    const double off[3] = {std::abs(p.x) - c.size[0], std::abs(p.y) - c.size[1],
                           std::abs(p.z) - c.size[2]};
    int at = 0;
    for (const double one : off) {
      if (one > reach) return false;
      at += one >= -reach;
    }
    return at >= 2;
  }
  if (c.shape == Shape::MESH)
    return collide::squared_to_box(p, c.mesh.bounds + 6 * c.root) <= reach * reach;
  const Vec a = features.points.front(), b = features.points.back();
  return overlap(p, p, min_of(a, b), max_of(a, b), reach);
}

bool FaceContacts::is_near(const StepCollider& c, const std::vector<std::int32_t>& near,
                           const StepRows& rows) const {
  const double reach = reach_ + collide::contact_distance(c.collider, radius_);
  return std::any_of(near.begin(), near.end(), [&](std::int32_t n) {
    const Vec from = c.begin.to_local(row_of(rows.before.data(), n));
    const Vec to = c.end.to_local(row_of(rows.x.data(), n));
    return may_touch({}, c.collider, to, reach + length(to - from));
  });
}

bool FaceContacts::collect_elements(const FineFeatures& features, const StepCollider& c,
                                    const std::vector<std::int32_t>& near, const StepRows& rows) {
  from_.clear();
  to_.clear();
  particles_.clear();
  inverse_masses_.clear();
  elements_.clear();
  std::vector<std::int32_t> marked;
  for (const std::int32_t n : near) {
    const Vec from = c.begin.to_local(row_of(rows.before.data(), n));
    const Vec to = c.end.to_local(row_of(rows.x.data(), n));
    if (!may_touch(features, c.collider, to, reach_ + features.radius + length(to - from)))
      continue;
    marked.push_back(n);
    marked_[static_cast<std::size_t>(n)] = 1;
  }
  if (marked.empty()) return false;
  const auto add_all = [&](const std::vector<std::int32_t>& of, int count) {
    for (std::size_t k = 0; k < of.size(); k += static_cast<std::size_t>(count))
      if (std::any_of(&of[k], &of[k] + count,
                      [&](std::int32_t n) { return marked_[static_cast<std::size_t>(n)]; }))
        add_element(&of[k], count, c, rows);
  };
  add_all(network_.edges, 2);
  add_all(network_.triangles, 3);
  for (const std::int32_t n : marked) marked_[static_cast<std::size_t>(n)] = 0;
  for (const Vec p : features.points) {
    const double row[ROW] = {p.x, p.y, p.z, 0};
    from_.insert(from_.end(), row, row + ROW);
    to_.insert(to_.end(), row, row + ROW);
    inverse_masses_.push_back(0);
  }
  return true;
}

std::int32_t FaceContacts::slot(std::int32_t particle, const StepCollider& c,
                                const StepRows& rows) {
  std::int32_t& entry = slots_[static_cast<std::size_t>(particle)];
  if (entry >= 0) return entry;
  entry = static_cast<std::int32_t>(particles_.size());
  particles_.push_back(particle);
  inverse_masses_.push_back(network_.inverse_masses[static_cast<std::size_t>(particle)]);
  from_.resize(from_.size() + ROW, 0.0);
  to_.resize(to_.size() + ROW, 0.0);
  store(c.begin.to_local(row_of(rows.before.data(), particle)), &from_[from_.size() - ROW]);
  store(c.end.to_local(row_of(rows.x.data(), particle)), &to_[to_.size() - ROW]);
  return entry;
}

void FaceContacts::add_element(const std::int32_t* corners, int count, const StepCollider& c,
                               const StepRows& rows) {
  Element one{{}, count, {}, {}};
  for (int k = 0; k < count; ++k)
    one.corners[static_cast<std::size_t>(k)] = slot(corners[k], c, rows);
  elements_.push_back(one);
}

// Number of axes along which an element reaches a face of a box: two at edges, three at corners.
static int sides_reached(const double* half, Vec low, Vec high, double reach) {
  const double lows[3] = {low.x, low.y, low.z}, highs[3] = {high.x, high.y, high.z};
  int sides = 0;
  for (int k = 0; k < 3; ++k)
    sides += (lows[k] <= half[k] + reach && highs[k] >= half[k] - reach) ||
             (lows[k] <= -half[k] + reach && highs[k] >= -half[k] - reach);
  return sides;
}

void FaceContacts::find_contacts(const FineFeatures& features, const StepCollider& c) {
  edges_.clear();
  corners_.clear();
  for (Element& one : elements_) {
    one.low = {collide::FAR, collide::FAR, collide::FAR}, one.high = -one.low;
    for (int k = 0; k < one.count; ++k)
      for (const auto* of : {&from_, &to_}) {
        const Vec at = row_of(of->data(), one.corners[static_cast<std::size_t>(k)]);
        one.low = min_of(one.low, at), one.high = max_of(one.high, at);
      }
  }
  const auto count = static_cast<std::int32_t>(features.points.size());
  const auto lines = static_cast<std::int32_t>(features.lines.size());
  std::vector<std::int32_t> entry;
  for (const Element& one : elements_) {
    if (c.collider.shape == Shape::BOX &&
        sides_reached(c.collider.size, one.low, one.high, features.radius) < one.count)
      continue;
    if (features.of_triangle.empty()) {
      for (std::int32_t k = 0; k < (one.count == 2 ? lines : count); ++k)
        add_contacts(features, one, k);
      continue;
    }
    const Vec off{features.radius, features.radius, features.radius};
    const std::size_t first = one.count == 2 ? 0 : 3;
    entry.clear();
    collide::visit_overlapping(c.collider.mesh, c.collider.root, one.low - off, one.high + off,
                               [&](std::int32_t t) {
                                 const auto& of = features.of_triangle[static_cast<std::size_t>(t)];
                                 for (std::size_t k = first; k < first + 3; ++k)
                                   if (of[k] >= 0) entry.push_back(of[k]);
                               });
    std::sort(entry.begin(), entry.end());
    entry.erase(std::unique(entry.begin(), entry.end()), entry.end());
    for (const std::int32_t k : entry) add_contacts(features, one, k);
  }
}

void FaceContacts::add_contacts(const FineFeatures& features, const Element& one,
                                std::int32_t feature) {
  const auto first = static_cast<std::int32_t>(particles_.size());
  const auto number = static_cast<std::size_t>(feature);
  if (one.count == 3) {
    const Vec p = features.points[number];
    if (overlap(p, p, one.low, one.high, features.radius))
      add_pair<shapes::CornerPair>(
          {first + feature, one.corners[0], one.corners[1], one.corners[2]}, features.radius);
    return;
  }
  const auto [i, j] = features.lines[number];
  const Vec a = features.points[static_cast<std::size_t>(i)];
  const Vec b = features.points[static_cast<std::size_t>(j)];
  if (overlap(min_of(a, b), max_of(a, b), one.low, one.high, features.radius))
    add_pair<shapes::EdgePair>({one.corners[0], one.corners[1], first + i, first + j},
                               features.radius);
}

template <class Shape>
void FaceContacts::add_pair(const FourParticles& who, double distance) {
  const Shape now(who.data(), to_.data());
  double travel = 0;
  for (const std::int32_t n : who)
    travel = std::max(travel, length(row_of(to_.data(), n) - row_of(from_.data(), n)));
  const shapes::Nearest near = now.nearest();
  const double gap = length(near.off);
  if (!(gap < distance + travel)) return;
  LayerHit hit{0, 0, 0, who, gap, travel, distance};
  if (gap <= travel) hit.side = shapes::crossed_from(Shape(who.data(), from_.data()), now);
  if (!hit.side && !near.inside) return;
  (std::is_same_v<Shape, shapes::EdgePair> ? edges_ : corners_).push_back(hit);
}

bool FaceContacts::separate(Separation& separation) const {
  bool any = false;
  for (const LayerHit& hit : corners_) any |= separation.separate<shapes::CornerPair>(hit);
  for (const LayerHit& hit : edges_) any |= separation.separate<shapes::EdgePair>(hit);
  return any;
}

void FaceContacts::write(const StepCollider& c, double h, StepRows& rows) {
  for (std::size_t k = 0; k < particles_.size(); ++k) {
    const Vec moved_by = load(&to_[ROW * k]) - load(&end_[ROW * k]);
    const Vec back = load(&from_[ROW * k]) - load(&start_[ROW * k]);
    if (dot(moved_by, moved_by) == 0 && dot(back, back) == 0) continue;
    const std::int32_t n = particles_[k];
    const std::size_t at = ROW * static_cast<std::size_t>(n);
    const Vec out = c.end.rotated(moved_by), shift = c.begin.rotated(back);
    store(load(&rows.x[at]) + out, &rows.x[at]);
    store(load(&rows.before[at]) + shift, &rows.before[at]);
    const Vec change = (out - shift) * (1 / h);
    if (rows.v) store(load(&(*rows.v)[at]) + change, &(*rows.v)[at]);
    moved.push_back({n, length(out) + length(shift), change});
  }
}

}  // namespace animtool
