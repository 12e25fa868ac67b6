// Broad phase: a bounding volume tree, rebuilt each step along a space-filling curve (Karras 2012,
// "Maximizing parallelism in the construction of BVHs", only its order), so that the work grows as
// n log n; and the contact of pairs at their time of impact.
#include <algorithm>
#include <cmath>
#include <memory>
#include <utility>

#include "rigid/world.h"

namespace animtool::rigid {

namespace {

using collide::Collider;
using collide::load;
using collide::Shape;

// Distance below which points of two bodies touch, over the smaller size.
constexpr double SKIN = 0.02;
// Search for the time of impact, and its tolerance over the smaller size.
constexpr int MAX_ADVANCES = 48;
constexpr double ARRIVAL_TOLERANCE = 1e-3;

struct Box {
  Vec low, high;
};

Box united(const Box& a, const Box& b) {
  return {
      {std::min(a.low.x, b.low.x), std::min(a.low.y, b.low.y), std::min(a.low.z, b.low.z)},
      {std::max(a.high.x, b.high.x), std::max(a.high.y, b.high.y), std::max(a.high.z, b.high.z)}};
}

bool overlap(const Box& a, const Box& b) {
  return a.low.x <= b.high.x && b.low.x <= a.high.x && a.low.y <= b.high.y && b.low.y <= a.high.y &&
         a.low.z <= b.high.z && b.low.z <= a.high.z;
}

Box box_of(const PosedCore& p, Vec displacement, double slack) {
  Box box{p.points[0], p.points[0]};
  for (std::size_t i = 1; i < p.core->points.size(); ++i)
    box = united(box, {p.points[i], p.points[i]});
  const double r = p.core->radius + slack;
  box.low = box.low - Vec{r, r, r}, box.high = box.high + Vec{r, r, r};
  return united(box, {box.low + displacement, box.high + displacement});
}

std::uint32_t spread_bits(std::uint32_t v) {
  v = (v | v << 16) & 0x030000FFu;
  v = (v | v << 8) & 0x0300F00Fu;
  v = (v | v << 4) & 0x030C30C3u;
  return (v | v << 2) & 0x09249249u;
}

// Boxes along the curve, halved recursively.
class Tree {
 public:
  explicit Tree(const std::vector<Box>& boxes) : boxes_(boxes), order_(boxes.size()) {
    if (boxes.empty()) return;
    Box all = {mid(0), mid(0)};
    for (std::size_t i = 1; i < boxes.size(); ++i) all = united(all, {mid(i), mid(i)});
    const Vec size = all.high - all.low;
    std::vector<std::uint64_t> keys(boxes.size());
    const auto cell = [](double at, double extent) {
      const double fraction = extent > 0 ? at / extent * 1023 : 0;
      return static_cast<std::uint32_t>(fraction > 0 ? std::min(fraction, 1023.0) : 0);
    };
    for (std::size_t i = 0; i < boxes.size(); ++i) {
      const Vec at = mid(i) - all.low;
      const std::uint64_t code = spread_bits(cell(at.x, size.x)) |
                                 spread_bits(cell(at.y, size.y)) << 1 |
                                 spread_bits(cell(at.z, size.z)) << 2;
      keys[i] = code << 32 | i;
    }
    std::sort(keys.begin(), keys.end());
    for (std::size_t i = 0; i < keys.size(); ++i) order_[i] = keys[i] & 0xFFFFFFFFu;
    nodes_.reserve(2 * boxes.size());
    build(0, boxes.size());
  }

  // Visits each pair of overlapping boxes once.
  template <class Visitor>
  void pairs(Visitor visitor) const {
    for (std::size_t i = 0; i < order_.size(); ++i) visit(0, 0, order_.size(), i, visitor);
  }

 private:
  Vec mid(std::size_t i) const { return (boxes_[i].low + boxes_[i].high) * 0.5; }

  std::size_t build(std::size_t from, std::size_t to) {
    const std::size_t self = nodes_.size();
    nodes_.push_back({boxes_[order_[from]], 0});
    if (to - from > 1) {
      const std::size_t half = from + (to - from) / 2;
      build(from, half);
      const std::size_t right = build(half, to);
      nodes_[self] = {united(nodes_[self + 1].box, nodes_[right].box), right};
    }
    return self;
  }

  // Leaves after this one in the order.
  template <class Visitor>
  void visit(std::size_t node, std::size_t from, std::size_t to, std::size_t i,
             Visitor& visitor) const {
    if (to <= i + 1 || !overlap(nodes_[node].box, boxes_[order_[i]])) return;
    if (to - from == 1) return visitor(order_[i], order_[from]);
    const std::size_t half = from + (to - from) / 2;
    visit(node + 1, from, half, i, visitor);
    visit(nodes_[node].right, half, to, i, visitor);
  }

  struct Node {
    Box box;
    std::size_t right;
  };
  const std::vector<Box>& boxes_;
  std::vector<std::size_t> order_;
  std::vector<Node> nodes_;
};

bool convex(const Collider& c) {
  return !c.container &&
         (c.shape == Shape::SPHERE || c.shape == Shape::CAPSULE || c.shape == Shape::BOX);
}

// A box about the origin of its frame.
Core box_core(Vec half) {
  Core core;
  for (int i = 0; i < 8; ++i)
    core.points.push_back(
        {i & 1 ? half.x : -half.x, i & 2 ? half.y : -half.y, i & 4 ? half.z : -half.z});
  core.loops = {1, 3, 7, 5, 0, 4, 6, 2, 2, 6, 7, 3, 0, 1, 5, 4, 4, 5, 7, 6, 0, 2, 3, 1};
  core.starts = {0, 4, 8, 12, 16, 20, 24};
  core.finish();
  return core;
}

Core core_of(const Collider& c) {
  if (c.shape == Shape::BOX) {
    Core core = box_core(load(c.size));
    core.radius = c.margin;
    core.finish();
    return core;
  }
  Core core;
  core.points.push_back(collide::load(c.size));
  if (c.shape == Shape::CAPSULE) core.points.push_back(collide::load(c.size + 3));
  core.radius = c.size[c.shape == Shape::CAPSULE ? 6 : 3] + c.margin;
  core.finish();
  return core;
}

// Free motion of bodies within a step.
struct FreeMotion {
  State begin;
  Vec velocity, spin;

  Pose at(double t) const {
    State s = begin;
    s.at = s.at + velocity * t;
    s.rotation = unit(rotation_of(spin * t) * s.rotation);
    return pose_of(s);
  }
};

class Finder {
 public:
  Finder(const World& world, const std::vector<State>& states,
         const std::vector<Collider>& colliders, const Settings& settings, double step)
      : world_(world), colliders_(colliders), settings_(settings), step_(step) {
    motions_.reserve(states.size());
    for (std::size_t i = 0; i < states.size(); ++i)
      motions_.push_back({states[i], states[i].velocity, spin_of(world.bodies[i], states[i])});
  }

  std::vector<Contact> find() {
    pose_shapes();
    const Tree tree(boxes_);
    std::vector<std::pair<std::size_t, std::size_t>> pairs;
    tree.pairs([&](std::size_t i, std::size_t j) {
      if (i > j) std::swap(i, j);
      if (may_collide(i, j)) pairs.emplace_back(i, j);
    });
    std::sort(pairs.begin(), pairs.end());
    for (const auto& [i, j] : pairs) collide_pair(i, j);
    for (std::size_t s = 0; s < world_.shapes.size(); ++s) {
      for (std::size_t c = 0; c < colliders_.size(); ++c) {
        if (convex(colliders_[c]) || (sleeps(s) && !colliders_[c].motion.moves())) continue;
        if (excludes_collider(s, c)) continue;
        if (colliders_[c].shape == Shape::MESH) {
          collide_mesh(s, c);
        } else {
          collide_field(s, c);
        }
      }
    }
    std::stable_sort(contacts_.begin(), contacts_.end(), [](const Contact& a, const Contact& b) {
      return a.first != b.first ? a.first < b.first : a.second < b.second;
    });
    return std::move(contacts_);
  }

 private:
  bool sleeps(std::size_t s) const {
    return asleep(motions_[world_.shapes[s].body].begin, settings_);
  }

  std::size_t shapes() const { return world_.shapes.size(); }

  void pose_shapes() {
    const std::size_t count = shapes();
    poses_.resize(motions_.size());
    for (std::size_t i = 0; i < motions_.size(); ++i) poses_[i] = pose_of(motions_[i].begin);
    std::size_t points = 0;
    for (const auto& shape : world_.shapes) points += shape.core.points.size() + shape.core.faces();
    posed_.resize(count);
    for (std::size_t s = 0; s < count; ++s) {
      const auto& shape = world_.shapes[s];
      posed_[s].set(shape.core, poses_[shape.body]);
      const FreeMotion& g = motions_[shape.body];
      const double swept = length(g.spin) * step_ * world_.bodies[shape.body].reach;
      boxes_.push_back(
          box_of(posed_[s].get(), g.velocity * step_, swept + SKIN * shape.core.reach));
      owners_.push_back(s);
    }
    for (std::size_t c = 0; c < colliders_.size(); ++c) {
      if (!convex(colliders_[c])) continue;
      const collide::Motion& m = colliders_[c].motion;
      cores_.push_back(std::make_unique<Core>(core_of(colliders_[c])));
      posed_.emplace_back();
      posed_.back().set(*cores_.back(), m.at(0));
      const double swept = m.angle() * cores_.back()->reach;
      boxes_.push_back(box_of(posed_.back().get(), m.travel(), swept));
      owners_.push_back(count + c);
    }
  }

  // Of two bodies, or of a body and a collider; colliders are numbered after the bodies.
  bool excluded(std::size_t a, std::size_t b) const {
    if (world_.excluded.empty()) return false;
    const std::uint64_t key = static_cast<std::uint64_t>(std::min(a, b)) << 32 | std::max(a, b);
    return std::binary_search(world_.excluded.begin(), world_.excluded.end(), key);
  }

  bool excludes_collider(std::size_t s, std::size_t c) const {
    return excluded(world_.shapes[s].body, world_.bodies.size() + c);
  }

  // Shapes come before colliders.
  bool may_collide(std::size_t i, std::size_t j) const {
    if (i >= shapes()) return false;
    if (j >= shapes()) {
      const Collider& c = colliders_[owners_[j] - shapes()];
      return (!sleeps(i) || c.motion.moves()) && !excludes_collider(i, owners_[j] - shapes());
    }
    const std::size_t a = world_.shapes[i].body, b = world_.shapes[j].body;
    return a != b && !(sleeps(i) && sleeps(j)) && !excluded(a, b);
  }

  // Upper bound of the approach speed of two along a direction.
  static double approach_bound(Vec displacement, double rotation_bound, Vec normal) {
    return std::max(-dot(displacement, normal), 0.0) + rotation_bound;
  }

  void collide_pair(std::size_t i, std::size_t j) {
    const PosedCore& p = posed_[i].get();
    const PosedCore& q = posed_[j].get();
    const std::size_t a = world_.shapes[i].body;
    const bool fixed = j >= shapes();
    const std::size_t b = fixed ? 0 : world_.shapes[j].body;
    const double size = std::min(p.core->reach, q.core->reach), skin = SKIN * size;
    const collide::Motion* motion = fixed ? &colliders_[owners_[j] - shapes()].motion : nullptr;
    const Vec other = fixed ? motion->travel() * (1 / step_) : motions_[b].velocity;
    const Vec displacement = (other - motions_[a].velocity) * step_;
    const double spin = fixed ? motion->angle() : length(motions_[b].spin) * step_;
    const double rotation_bound =
        length(motions_[a].spin) * step_ * p.core->reach + spin * q.core->reach;
    const double max_displacement = length(displacement) + rotation_bound;
    const Axis axis =
        separating_axis(p, q, max_displacement + skin + p.core->radius + q.core->radius);
    const double gap = axis.gap - p.core->radius - q.core->radius;
    if (gap > max_displacement + skin) return;
    Contact contact;
    contact.motion = motion;
    contact.radius = p.core->radius, contact.other_radius = q.core->radius;
    // Near or slow pairs are tested at the start; far and fast ones at their arrival.
    if (gap <= skin + std::min(max_displacement, size * ARRIVAL_TOLERANCE)) {
      const Manifold manifold = manifold_of(p, q, skin + max_displacement);
      contact.take(manifold, poses_[a], fixed ? motion->at(0) : poses_[b]);
    } else {
      advance_to_impact(p, q, a, b, motion, contact, gap, axis, displacement, rotation_bound, size,
                        max_displacement);
    }
    if (!contact.count) return;
    contact.first = i, contact.second = static_cast<std::int64_t>(owners_[j]);
    contact.a = a, contact.b = fixed ? -1 : static_cast<std::ptrdiff_t>(b);
    Material other_material;
    if (fixed) {
      const Collider& c = colliders_[owners_[j] - shapes()];
      other_material = {c.restitution, c.friction}, contact.depenetration = c.depenetration;
    } else {
      other_material = world_.shapes[j].material;
    }
    contact.material = combined(world_.shapes[i].material, other_material);
    contacts_.push_back(contact);
  }

  static Material combined(const Material& a, const Material& b) {
    return {std::max(a.restitution, b.restitution), std::max(a.friction, b.friction)};
  }

  // Conservative advancement to the time of impact (Mirtich 1996, "Impulse-based dynamic
  // simulation"), and the contact there.
  void advance_to_impact(const PosedCore& p, const PosedCore& q, std::size_t a, std::size_t b,
                         const collide::Motion* motion, Contact& contact, double gap, Axis axis,
                         Vec displacement, double rotation_bound, double size,
                         double max_displacement) {
    const double near = ARRIVAL_TOLERANCE * size, skin = p.core->radius + q.core->radius;
    Pose pose_a, pose_b;
    double fraction = 0;
    for (int i = 0; i < MAX_ADVANCES; ++i) {
      const double speed = approach_bound(displacement, rotation_bound, axis.normal);
      if (!(speed > 0)) return;
      fraction += std::max(gap - near / 2, near / 2) / speed;
      if (fraction > 1) return;
      pose_a = motions_[a].at(fraction * step_);
      pose_b = motion ? motion->at(fraction) : motions_[b].at(fraction * step_);
      moved_a_.set(*p.core, pose_a);
      moved_b_.set(*q.core, pose_b);
      axis = separating_axis(moved_a_.get(), moved_b_.get(), collide::FAR);
      gap = axis.gap - skin;
      if (gap <= near) break;
    }
    const double reach = std::max(gap, 0.0) + SKIN * size + max_displacement * (1 - fraction);
    contact.take(manifold_of(moved_a_.get(), moved_b_.get(), reach), pose_a, pose_b);
  }

  void add(std::size_t s, std::size_t c, const Manifold& manifold) {
    Contact contact;
    const Collider& collider = colliders_[c];
    contact.first = s, contact.second = static_cast<std::int64_t>(shapes() + c);
    contact.a = world_.shapes[s].body, contact.b = -1;
    contact.radius = world_.shapes[s].core.radius;
    contact.take(manifold, poses_[contact.a], collider.motion.at(0));
    contact.motion = &collider.motion;
    contact.depenetration = collider.depenetration;
    contact.material =
        combined(world_.shapes[s].material, {collider.restitution, collider.friction});
    contacts_.push_back(contact);
  }

  // One of the six walls of a container, seen from inside.
  static collide::Sample from_wall(const Collider& c, const Pose& pose, Vec point, double radius,
                                   int wall) {
    const Vec local = pose.to_local(point);
    const double at[3] = {local.x, local.y, local.z}, sign = wall % 2 ? -1 : 1;
    double inward[3] = {0, 0, 0};
    inward[wall / 2] = -sign;
    return {c.size[wall / 2] - sign * at[wall / 2] - c.margin - radius, pose.rotated(load(inward))};
  }

  // Planes and containers: contact points with the normal at each.
  void collide_field(std::size_t s, std::size_t c) {
    const PosedCore& p = posed_[s].get();
    const Collider& collider = colliders_[c];
    const FreeMotion& g = motions_[world_.shapes[s].body];
    const double reach = SKIN * p.core->reach + length(g.spin) * step_ * p.core->reach +
                         length(g.velocity * step_ - collider.motion.travel()) +
                         collider.motion.angle() * length(p.centre);
    const Pose pose = collider.motion.at(0);
    const double away = length(p.centre - poses_[world_.shapes[s].body].origin) + p.core->reach;
    if (collide::sample(collider, pose, p.centre, away, reach).distance > reach) return;
    fields_.clear();
    const int sides = collider.shape == Shape::BOX ? 6 : 1;
    for (std::size_t i = 0; i < sides * p.core->points.size(); ++i) {
      const Vec point = p.points[i / static_cast<std::size_t>(sides)];
      const auto sample = sides == 1 ? collide::sample(collider, pose, point, p.core->radius, reach)
                                     : from_wall(collider, pose, point, p.core->radius,
                                                 static_cast<int>(i) % sides);
      if (sample.distance > reach) continue;
      const Vec n = -sample.normal;
      const ContactPoint touching{point + n * (p.core->radius + sample.distance / 2),
                                  sample.distance};
      auto same = std::find_if(fields_.begin(), fields_.end(),
                               [&](const auto& one) { return dot(one.first, n) > 1 - 1e-9; });
      if (same == fields_.end()) same = fields_.insert(fields_.end(), {n, {}});
      same->second.push_back(touching);
    }
    for (auto& [n, points] : fields_) {
      Manifold manifold;
      manifold.normal = n;
      reduce_to_four(points, n, manifold);
      add(s, c, manifold);
    }
  }

  void collide_mesh(std::size_t s, std::size_t c) {
    const PosedCore& p = posed_[s].get();
    const Collider& collider = colliders_[c];
    const Pose pose = collider.motion.at(0);
    const collide::Mesh& mesh = collider.mesh;
    const FreeMotion& g = motions_[world_.shapes[s].body];
    const Vec displacement = g.velocity * step_ - collider.motion.travel();
    const double rotation_bound = length(g.spin) * step_ * p.core->reach +
                                  collider.motion.angle() * length(p.centre - pose.origin);
    const double reach =
        SKIN * p.core->reach + length(displacement) + rotation_bound + collider.margin;
    Box local{pose.to_local(p.points[0]), pose.to_local(p.points[0])};
    for (std::size_t i = 1; i < p.core->points.size(); ++i) {
      const Vec at = pose.to_local(p.points[i]);
      local = united(local, {at, at});
    }
    const double r = p.core->radius + reach;
    const std::size_t before = contacts_.size();
    bool behind = false;
    collide::visit_overlapping(
        mesh, collider.root, local.low - Vec{r, r, r}, local.high + Vec{r, r, r},
        [&](std::int32_t t) { behind |= !meet_triangle(s, c, t, pose, reach); });
    if (behind && contacts_.size() == before) meet_inside(s, c, pose, reach);
  }

  // Bodies inside a mesh, whose centre is on the outward direction of the nearest point.
  void meet_inside(std::size_t s, std::size_t c, const Pose& pose, double reach) {
    const PosedCore& p = posed_[s].get();
    const auto out = collide::sample(colliders_[c], pose, p.centre, 0, p.core->reach + reach);
    if (!(out.distance < 0)) return;
    std::vector<ContactPoint> points;
    for (std::size_t i = 0; i < p.core->points.size(); ++i) {
      const Vec at = p.points[i];
      const double gap = out.distance + dot(out.normal, at - p.centre) - p.core->radius;
      if (gap <= reach) points.push_back({at - out.normal * (p.core->radius + gap / 2), gap});
    }
    Manifold manifold;
    manifold.normal = -out.normal;
    reduce_to_four(points, manifold.normal, manifold);
    add(s, c, manifold);
  }

  // Whether a point of the world is behind a triangle of a mesh.
  static bool behind(const collide::Mesh& mesh, std::int32_t t, const Pose& pose, Vec point) {
    const std::int32_t* corner = mesh.triangles + 3 * t;
    const Vec a = mesh.point(corner[0]), at = pose.to_local(point);
    return dot(cross(mesh.point(corner[1]) - a, mesh.point(corner[2]) - a), at - a) < 0;
  }

  // Returns whether a body is in front of a triangle.
  bool meet_triangle(std::size_t s, std::size_t c, std::int32_t t, const Pose& pose, double reach) {
    const PosedCore& p = posed_[s].get();
    const collide::Mesh& mesh = colliders_[c].mesh;
    Core core;
    // Containers collide from behind, two-sided triangles from the side of the body.
    const bool two_sided = colliders_[c].two_sided;
    const bool turned = colliders_[c].container || (two_sided && behind(mesh, t, pose, p.centre));
    for (int k = 0; k < 3; ++k)
      core.points.push_back(mesh.point(mesh.triangles[3 * t + (turned ? (3 - k) % 3 : k)]));
    core.loops = {0, 1, 2, 0, 2, 1};
    core.starts = {0, 3, 6};
    core.radius = colliders_[c].margin;
    core.finish();
    moved_b_.set(core, pose);
    const PosedCore& q = moved_b_.get();
    const Vec face = q.normals[0];
    // Points behind a face collide with its other side, or with the full mesh.
    if (!two_sided && dot(p.centre - q.points[0], face) < 0) return false;
    Manifold manifold = manifold_of(q, p, reach);
    if (!manifold.count) return true;
    if (!faces_out(mesh, t, turned, pose, manifold, q))
      manifold = triangle_manifold(q, p, reach, two_sided);
    if (!manifold.count) return true;
    manifold.normal = -manifold.normal;
    add(s, c, manifold);
    return true;
  }

  // Whether a normal is within the normal cone of the surface: at an edge between those of its two
  // faces, so that sliding bodies do not catch on inner edges.
  static bool faces_out(const collide::Mesh& mesh, std::int32_t t, bool turned, const Pose& pose,
                        const Manifold& manifold, const PosedCore& q) {
    const Vec n = manifold.normal, face = q.normals[0];
    const double cosine = dot(n, face);
    if (cosine > 1 - 1e-6) return true;
    if (cosine <= 0) return false;
    const Vec at = manifold.points[0].at;
    int side = 0;
    double least = collide::FAR;
    for (int k = 0; k < 3; ++k) {
      const Vec a = q.points[k], b = q.points[(k + 1) % 3], along = b - a;
      const double fraction = std::clamp(dot(at - a, along) / dot(along, along), 0.0, 1.0);
      const Vec off = at - a - along * fraction;
      if (dot(off, off) < least) least = dot(off, off), side = k;
    }
    const Vec out_there =
        pose.rotated(load(mesh.edge_normals + 9 * t + 3 * (turned ? 2 - side : side)));
    const Vec sum = turned ? -out_there : out_there;
    if (dot(sum, sum) == 0) return true;  // a boundary edge
    const Vec other =
        direction(direction(sum, face) * (2 * dot(direction(sum, face), face)) - face, face);
    const Vec along = q.points[(side + 1) % 3] - q.points[side];
    const Vec out = cross(along, face);
    if (dot(other, out) <= 1e-6) return false;  // flat, or concave
    return cosine >= dot(other, face) - 1e-3;
  }

  // Whether a segment crosses a triangle.
  static bool crosses(const PosedCore& q, Vec from, Vec to) {
    const Vec n = q.normals[0], displacement = to - from;
    const double begin = dot(n, from - q.points[0]), end = dot(n, to - q.points[0]);
    if ((begin > 0) == (end > 0)) return false;
    const Vec at = from + displacement * (begin / (begin - end));
    for (int k = 0; k < 3; ++k)
      if (dot(cross(q.points[(k + 1) % 3] - q.points[k], at - q.points[k]), n) < 0) return false;
    return true;
  }

  // Points of a core against the front of a triangle.
  static Manifold triangle_manifold(const PosedCore& q, const PosedCore& p, double reach,
                                    bool two_sided) {
    const Vec n = q.normals[0];
    std::vector<ContactPoint> points;
    for (std::size_t i = 0; i < p.core->points.size(); ++i) {
      const Vec at = p.points[i];
      const double height = dot(n, at - q.points[0]);
      const double gap = height - p.core->radius - q.core->radius;
      if (gap > reach) continue;
      bool within = true;
      for (int k = 0; k < 3; ++k)
        within &= dot(cross(q.points[(k + 1) % 3] - q.points[k], at - q.points[k]), n) >= 0;
      // Behind a two-sided triangle counts what crosses it, not its edges.
      if (within && two_sided && height < 0) within = crosses(q, p.centre, at);
      if (within) points.push_back({at - n * (height - q.core->radius - gap / 2), gap});
    }
    Manifold manifold;
    manifold.normal = n;
    reduce_to_four(points, n, manifold);
    return manifold;
  }

  const World& world_;
  const std::vector<Collider>& colliders_;
  const Settings& settings_;
  double step_;
  std::vector<FreeMotion> motions_;
  std::vector<Pose> poses_;
  std::vector<CorePoser> posed_;
  std::vector<Box> boxes_;
  std::vector<std::size_t> owners_;  // of each box a shape, or a collider after the shapes
  std::vector<std::unique_ptr<Core>> cores_;
  std::vector<std::pair<Vec, std::vector<ContactPoint>>> fields_;
  CorePoser moved_a_, moved_b_;
  std::vector<Contact> contacts_;
};

}  // namespace

std::vector<Contact> find_contacts(const World& world, const std::vector<State>& states,
                                   const std::vector<Collider>& colliders, const Settings& settings,
                                   double step) {
  return Finder(world, states, colliders, settings, step).find();
}

}  // namespace animtool::rigid
