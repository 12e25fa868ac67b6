// A step of rigid bodies: small steps, in each of which forces act, contacts and joints are
// solved one after the other until velocities hardly change, bodies go on, and what pushed them
// apart is taken out of their velocities again (Catto 2023, "Solver2D": soft contacts, small
// steps and relaxation). Bodies that nothing touches go on exactly.
#include <algorithm>
#include <cmath>
#include <numeric>

#include "rigid/drives.h"
#include "rigid/impacts.h"
#include "rigid/points.h"
#include "rigid/world.h"

namespace animtool::rigid {

namespace {

// Of contacts and joints, how hard they are pushed back to where they should be: a frequency,
// over that of the small steps, and a damping ratio.
constexpr double STIFF = 0.35;
constexpr double CONTACT_DAMPING = 10, JOINT_DAMPING = 2;
// Speed at which bodies that begin inside each other are moved apart at most [m/s].
constexpr double PUSH = 2;
// Speed at which joints that begin apart are closed at most [m/s, rad/s].
constexpr double PULL = 100;
// A point of contact is the one of the step before where it is as near, over the size.
constexpr double SAME = 0.1;
// Islands of fewer points than these are corrected more often, and at most so much more.
constexpr std::size_t SMALL = 512, MOST = 32;
// Who arrives within so many small steps is not stopped before; who arrives within such a share
// of one is there.
constexpr double FLIES = 2, SOON = 1.0 / 64;
// Most times at which an island is stopped for impacts in a small step, fewer for a crowd of
// pairs; most rounds at one, and most looks for when it is.
constexpr std::size_t LEGS = 32, CROWD = 256;
constexpr int AGAIN = 4, ARRIVES = 16;
// Arms of contacts follow bodies that turn by more than this share of their size.
constexpr double TURNED = 1e-3;
// Friction at so many points holds a body; what leans on fewer, or is not held at all, falls
// asleep below such a share of the speed of sleep.
constexpr int HELD = 3;
constexpr double LEANING = 0.25, CREEP = 0.01;
// Drives swing by less than this in a small step [rad], of which there are so many times more
// at most; what then swings by more than so much is not as it should be.
constexpr double SWING = 0.2, MOST_PARTS = 64, TOO_FAR = 0.5;
// Likewise of what moves more than it feels.
constexpr double LOSES = 0.02;
// Friction this near its limit slides.
constexpr double SLIDING = 1e-6;
// Who is deeper in another than this share of his size does not fall asleep.
constexpr double PARTING = 0.02;

class Solver {
 public:
  Solver(const World& world, std::vector<State>& states, std::vector<Kept>& kept,
         std::vector<std::array<double, ROWS>>& held, const std::vector<Vec>& forces,
         const std::vector<Vec>& torques, const std::vector<collide::Collider>& colliders,
         const std::vector<collide::Motion>& anchors, const Settings& settings, double step)
      : world_(world), states_(states), kept_(kept), held_(held), forces_(forces),
        torques_(torques), colliders_(colliders), anchors_(anchors), settings_(settings),
        step_(step), small_(step / settings.substeps), h_(small_), count_(states.size()) {}

  // Whether two approach so fast that they will bounce within the step.
  bool bounces() {
    find();
    for (const Contact& c : contacts_) {
      if (!(c.material.restitution > 0)) continue;
      const State& a = states_[c.a];
      const std::size_t b = c.b < 0 ? count_ : static_cast<std::size_t>(c.b);
      const Vec spin = spin_of(world_.bodies[c.a], a);
      const Pose pose = pose_of(a), other = c.b < 0 ? c.motion->at(0) : pose_of(states_[b]);
      const double rest = rest_of(c.a, b, c.material.restitution);
      for (std::size_t k = 0; k < static_cast<std::size_t>(c.count); ++k) {
        const Vec own = a.velocity + cross(spin, pose.rotated(c.own[k]));
        const Vec theirs =
            c.b < 0 ? c.motion->displacement(other.to_world(c.other[k]), other) * (1 / step_)
                    : states_[b].velocity + cross(spin_of(world_.bodies[b], states_[b]),
                                                  other.rotated(c.other[k]));
        if (dot(own - theirs, c.normal) > rest) return true;
      }
    }
    return false;
  }

  Report run() {
    if (!found_) find();
    if (wake()) find();
    make_islands();
    speeds_.assign(count_ + 1, {});
    pushed_.assign(count_ + 1, 0);
    held_at_.assign(count_, 0);
    turns_.resize(count_);
    for (auto& island : islands_) solve(island);
    keep();
    rest();
    return report_;
  }

 private:
  struct Island {
    std::vector<std::size_t> bodies, joints;
    std::vector<std::size_t> contacts;
    bool parting = false;  // somebody is still on the way out of another
  };

  void find() {
    contacts_ = find_contacts(world_, states_, colliders_, settings_, step_);
    found_ = true;
  }

  // ---- who is awake

  std::size_t top(std::size_t i) {
    while (parents_[i] != i) i = parents_[i] = parents_[parents_[i]];
    return i;
  }
  void join(std::size_t i, std::size_t j) {
    i = top(i), j = top(j);
    if (i != j) parents_[std::max(i, j)] = std::min(i, j);
  }
  void begin_groups() {
    parents_.resize(count_);
    std::iota(parents_.begin(), parents_.end(), std::size_t{0});
    for (const Joint& joint : world_.joints)
      if (joint.a >= 0) join(static_cast<std::size_t>(joint.a), joint.b);
  }
  bool sleeps(std::size_t i) const { return asleep(states_[i], settings_); }

  // Wakes those that somebody awake touches, with all that they touch.
  bool wake() {
    if (!(settings_.drowsy > 0)) return false;
    begin_groups();
    const auto shapes = static_cast<std::int64_t>(world_.shapes.size());
    for (const Kept& one : kept_)
      if (one.second < shapes)
        join(world_.shapes[static_cast<std::size_t>(one.first)].body,
             world_.shapes[static_cast<std::size_t>(one.second)].body);
    std::vector<char> called(count_, 0);
    const auto call = [&](std::size_t i) { called[top(i)] = 1; };
    for (std::size_t i = 0; i < count_; ++i)
      if (!sleeps(i)) called[top(i)] = 1;
    for (const Contact& c : contacts_) {
      const auto b = static_cast<std::size_t>(c.b);
      if (c.b < 0 ? sleeps(c.a) && c.motion->moves() : sleeps(c.a) != sleeps(b)) {
        call(c.a);
        if (c.b >= 0) call(b);
      }
    }
    for (std::size_t k = 0; k < world_.joints.size(); ++k) {
      const Joint& joint = world_.joints[k];
      if (joint.a < 0 ? sleeps(joint.b) && anchors_[k].moves()
                      : sleeps(joint.b) != sleeps(static_cast<std::size_t>(joint.a)))
        call(joint.b);
    }
    bool woken = false;
    for (std::size_t i = 0; i < count_; ++i)
      if (called[top(i)] && sleeps(i)) states_[i].idle = 0, woken = true;
    return woken;
  }

  void make_islands() {
    begin_groups();
    for (const Contact& c : contacts_)
      if (c.b >= 0) join(c.a, static_cast<std::size_t>(c.b));
    std::vector<std::size_t> number(count_, count_);
    for (std::size_t i = 0; i < count_; ++i) {
      if (sleeps(i)) continue;
      std::size_t& n = number[top(i)];
      if (n == count_) n = islands_.size(), islands_.emplace_back();
      islands_[n].bodies.push_back(i);
      ++report_.awake;
    }
    for (std::size_t k = 0; k < contacts_.size(); ++k) {
      const std::size_t n = number[top(contacts_[k].a)];
      if (n < islands_.size()) islands_[n].contacts.push_back(k);
    }
    for (std::size_t k = 0; k < world_.joints.size(); ++k) {
      const std::size_t n = number[top(world_.joints[k].b)];
      if (n < islands_.size()) islands_[n].joints.push_back(k);
    }
  }

  // ---- one island

  void solve(Island& island) {
    for (const std::size_t i : island.bodies) {
      turns_[i] = pose_of(states_[i]);
      speeds_[i].ease = world_.bodies[i].ease;
      speeds_[i].v = states_[i].velocity;
      speeds_[i].w = spin_of(world_.bodies[i], states_[i]);
      refresh(i);
    }
    rows_.assign(island.joints.size(), {});
    divide(island);
    patches_.clear(), points_.clear();
    patches_.reserve(island.contacts.size()), points_.reserve(MOST_POINTS * island.contacts.size());
    for (const std::size_t k : island.contacts) add_patch(contacts_[k]);
    bouncy_ = std::any_of(patches_.begin(), patches_.end(),
                          [](const Patch& patch) { return patch.restitution > 0; });
    for (int s = 0; s < parts_; ++s) small_step(island, s);
    for (const Patch& patch : patches_) {
      save(patch);
      const double slack = PARTING * world_.bodies[patch.a].reach;
      for (std::size_t k = patch.begin; k < patch.end; ++k)
        island.parting |= points_[k].now < -slack;
      note_held(patch);
    }
    for (std::size_t k = 0; k < island.joints.size(); ++k) {
      auto& slots = held_[island.joints[k]];
      slots.fill(0);
      const double reach = world_.bodies[world_.joints[island.joints[k]].b].reach;
      for (std::size_t r = 0; r < rows_[k].count; ++r) {
        const Row& row = rows_[k].of[r];
        slots[static_cast<std::size_t>(row.slot)] = row.impulse / small_;
        const bool turns = dot(row.line, row.line) == 0;
        const double off = row.kind == Row::LIMIT ? -row.error : std::fabs(row.error);
        island.parting |= row.kind != Row::DRIVE && off > PARTING * (turns ? 1 : reach);
      }
    }
  }

  // Chooses small steps of an island, shorter where a drive swings in them.
  void divide(const Island& island) {
    resize(settings_.substeps);
    const std::size_t count = island.joints.size();
    drives_.assign(count, {}), hard_ = false;
    const auto is_driven = [&](std::size_t k) { return driven(world_.joints[k]); };
    if (!std::any_of(island.joints.begin(), island.joints.end(), is_driven)) return;
    for (std::size_t k = 0; k < count; ++k) write_rows(island.joints[k], k, 0, true);
    hard_ = find_masses(world_.joints, island.joints, rows_, speeds_, drives_);
    double parts = 1;
    for (std::size_t k = 0; k < count; ++k)
      for (const Drive& drive : drives_[k]) {
        const double swing = swing_of(world_.joints[island.joints[k]], drive.mass, small_);
        parts = std::max(parts, swing * small_ / (drive.known ? SWING : LOSES));
        const double most = (drive.known ? TOO_FAR : LOSES) * MOST_PARTS;
        if (swing * small_ > most)
          report_.note_drive(step_ * most / (swing * small_), island.joints[k]);
      }
    if (parts > 1)
      resize(settings_.substeps * static_cast<int>(std::ceil(std::min(parts, MOST_PARTS))));
  }

  void resize(int parts) {
    const double small = step_ / parts;
    // An impact of the island before may have left another time.
    const bool same = small == small_ && h_ == small;
    parts_ = parts, small_ = h_ = small;
    if (!same) soften();
  }

  void soften() {
    contact_ = Softness::of(STIFF / small_, CONTACT_DAMPING, h_);
    joint_ = Softness::of(STIFF / small_, JOINT_DAMPING, h_);
  }

  // Counts the points at which friction holds bodies: what slides is not held, and what is
  // round rolls on.
  void note_held(const Patch& patch) {
    if (!(patch.friction > 0)) return;
    int count = 0;
    for (std::size_t k = patch.begin; k < patch.end; ++k) {
      const Point& p = points_[k];
      const double limit = patch.friction * p.force * (1 - SLIDING);
      count += p.across[0] * p.across[0] + p.across[1] * p.across[1] < limit * limit;
    }
    const Contact& c = *patch.contact;
    if (world_.shapes[c.first].core.faces()) held_at_[patch.a] += count;
    if (patch.b < count_ && world_.shapes[static_cast<std::size_t>(c.second)].core.faces())
      held_at_[patch.b] += count;
  }

  void refresh(std::size_t i) {
    const double* r = turns_[i].turn;
    const double* e = world_.bodies[i].turning.of;
    double* to = speeds_[i].turning;
    for (int p = 0; p < 3; ++p)
      for (int q = p; q < 3; ++q) {
        const double sum = r[3 * p] * e[0] * r[3 * q] + r[3 * p + 1] * e[1] * r[3 * q + 1] +
                           r[3 * p + 2] * e[2] * r[3 * q + 2];
        to[3 * p + q] = to[3 * q + p] = sum;
      }
  }

  void add_patch(const Contact& c) {
    Patch patch;
    patch.a = c.a, patch.b = c.b < 0 ? count_ : static_cast<std::size_t>(c.b);
    patch.contact = &c;
    const Vec n = patch.normal = c.normal;
    patch.tangents[0] = collide::across(n);
    patch.tangents[1] = cross(n, patch.tangents[0]);
    patch.friction = c.material.friction, patch.restitution = c.material.restitution;
    patch.push = c.depenetration > 0 ? c.depenetration : PUSH;
    patch.begin = points_.size();
    patch.skin = c.radius + c.other_radius;
    const double size = TURNED * world_.bodies[c.a].reach;
    patch.turned = size * size;
    const Pose& pose_a = turns_[c.a];
    const Pose still = c.b < 0 ? c.motion->at(0) : turns_[patch.b];
    for (std::size_t k = 0; k < static_cast<std::size_t>(c.count); ++k) {
      Point& p = points_.emplace_back();
      p.own = c.own[k], p.other = c.other[k], p.gap = c.gaps[k];
      const Pose& pose_b = c.b < 0 ? still : turns_[patch.b];
      set_arms(patch, p, touching_point(patch, pose_a.to_world(p.own), pose_b.to_world(p.other)));
    }
    patch.end = points_.size();
    find_kept(patch);
    patches_.push_back(patch);
  }

  // One point for both, so that no angular momentum is lost: halfway, or on what is round.
  static Vec touching_point(const Patch& patch, Vec own, Vec other) {
    const Contact& c = *patch.contact;
    if (c.radius > 0) return own + patch.normal * c.radius;
    if (c.other_radius > 0) return other - patch.normal * c.other_radius;
    return (own + other) * 0.5;
  }

  // What there is of a point of contact where it is now.
  void set_arms(const Patch& patch, Point& p, Vec at) {
    const Vec at_a = p.arm_a = at - states_[patch.a].at;
    const Vec at_b = p.arm_b = patch.b < count_ ? at - states_[patch.b].at : Vec{};
    const Speed &sa = speeds_[patch.a], &sb = speeds_[patch.b];
    const Vec lines[3] = {patch.normal, patch.tangents[0], patch.tangents[1]};
    for (int d = 0; d < 3; ++d) {
      p.arms_a[d] = cross(at_a, lines[d]), p.arms_b[d] = cross(at_b, lines[d]);
      p.turns_a[d] = sa.turned(p.arms_a[d]), p.turns_b[d] = sb.turned(p.arms_b[d]);
      const double k = sa.ease + sb.ease + dot(p.arms_a[d], p.turns_a[d]) +
                       dot(p.arms_b[d], p.turns_b[d]);
      (d ? p.masses[d - 1] : p.mass) = k > 0 ? 1 / k : 0;
    }
    // One for both, so that friction is straight against what slides.
    p.masses[0] = p.masses[1] = std::min(p.masses[0], p.masses[1]);
  }

  // Begins with the forces of the step before.
  void find_kept(Patch& patch) {
    const Contact& c = *patch.contact;
    const auto first = static_cast<std::int64_t>(c.first);
    auto begin = std::lower_bound(kept_.begin(), kept_.end(), c, [&](const Kept& k, const Contact&) {
      return k.first != first ? k.first < first : k.second < c.second;
    });
    const double size = SAME * world_.bodies[c.a].reach;
    std::uint32_t taken = 0;
    for (std::size_t k = patch.begin; k < patch.end; ++k) {
      Point& p = points_[k];
      double least = size * size;
      int best = -1, i = 0;
      for (auto it = begin; it != kept_.end() && it->first == first && it->second == c.second &&
                            i < 32; ++it, ++i) {
        const Vec off = it->at - p.own;
        if (!(taken >> i & 1) && dot(off, off) < least) least = dot(off, off), best = i;
      }
      if (best < 0) continue;
      taken |= 1u << best;
      const Vec force = turns_[c.a].rotated((begin + best)->force) * h_;
      p.force = std::max(dot(force, patch.normal), 0.0);
      p.across[0] = dot(force, patch.tangents[0]), p.across[1] = dot(force, patch.tangents[1]);
    }
  }

  void save(const Patch& patch) {
    for (std::size_t k = patch.begin; k < patch.end; ++k) {
      const Point& p = points_[k];
      const Vec force = patch.normal * p.force + patch.tangents[0] * p.across[0] +
                        patch.tangents[1] * p.across[1];
      // In the frame of the body where the step begins; it turns little in one.
      const Vec own = turns_[patch.a].unrotated(force) * (1 / small_);
      saved_.push_back({static_cast<std::int64_t>(patch.contact->first), patch.contact->second,
                        p.own, own});
      if (-p.now > report_.deepest) {
        report_.deepest = -p.now;
        report_.first = static_cast<std::int64_t>(patch.contact->first);
        report_.second = patch.contact->second;
      }
      if (p.force > 0) ++report_.contacts;
    }
  }

  // ---- one small step

  // Goes from impact to impact, and what is left in one.
  void small_step(const Island& island, int s) {
    const double begin = static_cast<double>(s) / parts_;
    const double end = static_cast<double>(s + 1) / parts_;
    const std::size_t joints = island.joints.size();
    // Later ones begin where the one before ended.
    if (s == 0) {
      look(begin);
      for (std::size_t k = 0; k < joints; ++k) write_rows(island.joints[k], k, begin, true);
    }
    double left = small_;
    const int legs = static_cast<int>(
        std::clamp<std::size_t>(CROWD / std::max<std::size_t>(patches_.size(), 1), 1, LEGS));
    for (int leg = 0; bouncy_ && leg < legs; ++leg) {
      const double time = until_impact(island, left, begin, end);
      if (!(time < left)) break;
      left -= time;
      advance(island, time, begin + (end - begin) * (1 - left / small_));
    }
    advance(island, left, end);
  }

  // As RATTLE does (Andersen 1983): forces act for half the time, bodies go on with what leaves
  // joints and contacts right at the end, forces act for the other half, and velocities are made
  // right there.
  void advance(const Island& island, double time, double end) {
    const std::size_t joints = island.joints.size();
    // What stopped bodies at once is no force that lasts: it does not grow with the time.
    const double scale = std::min(time / h_, 1.0);
    if (time != h_) {
      h_ = time;
      soften();
      for (std::size_t k = 0; k < joints; ++k)
        write_rows(island.joints[k], k, end - time / step_, false);
    }
    for (const std::size_t i : island.bodies) pushed_[i] = 0;
    for (std::size_t k = 0; k < joints; ++k) begin_drives(world_.joints[island.joints[k]], k);
    for (const std::size_t i : island.bodies) push(i);
    for (Patch& p : patches_) begin_warm(p, scale);
    for (std::size_t k = 0; k < joints; ++k)
      begin_warm(world_.joints[island.joints[k]], rows_[k], scale);
    for (std::size_t k = 0; k < joints; ++k) bend(island.joints[k], rows_[k], end);
    iterate(island, true);
    mark(island);
    for (const std::size_t i : island.bodies) go(i);
    look(end);
    for (std::size_t k = 0; k < joints; ++k) write_rows(island.joints[k], k, end, false);
    for (std::size_t k = 0; k < joints; ++k) end_drives(world_.joints[island.joints[k]], k);
    for (const std::size_t i : island.bodies) push(i);
    for (Patch& p : patches_) end_warm(p);
    for (std::size_t k = 0; k < joints; ++k) end_warm(world_.joints[island.joints[k]], rows_[k]);
    iterate(island, false);
    mark(island);
    for (const std::size_t i : island.bodies) settle(i);
  }

  void begin_drives(const Joint& joint, std::size_t k) {
    each_drive(joint, k, [&](Drive& drive, Row& row) {
      begin_drive(joint, drive, row, speed_of(joint, row), h_);
    });
  }
  void end_drives(const Joint& joint, std::size_t k) {
    each_drive(joint, k, [&](Drive& drive, Row& row) {
      drive.first = row.impulse;
      end_drive(joint, drive, row, speed_of(joint, row), h_);
    });
  }
  template <typename Act>
  void each_drive(const Joint& joint, std::size_t k, Act act) {
    if (!driven(joint)) return;
    for (std::size_t r = 0; r < rows_[k].count; ++r) {
      Row& row = rows_[k].of[r];
      if (row.kind == Row::DRIVE)
        act(drives_[k][static_cast<std::size_t>(row.slot - SLOT_DRIVE)], row);
    }
  }

  // ---- impacts

  // How long nobody arrives who bounces, at most what is left; who is there bounces before.
  double until_impact(const Island& island, double left, double begin, double end) {
    const double soon = small_ * SOON;
    for (int again = 0; again < AGAIN; ++again) {
      const double share = begin + (end - begin) * (1 - left / small_);
      const double time = next_arrival(left, share);
      if (time > soon || !(time < left)) return time;
      for (const std::size_t i : island.bodies) pushed_[i] = 0;
      Impacts impacts(world_, patches_, points_, island.joints, rows_, speeds_,
                      settings_.tolerance, soon);
      impacts.run([&](const Patch& patch) { return rest_of(patch); }, pushed_);
      for (const std::size_t i : island.bodies) settle(i);
    }
    return left;
  }

  // Notes who comes so fast that he bounces; returns when the first arrives, or the time that
  // is left.
  double next_arrival(double left, double share) {
    double first = left;
    for (Patch& patch : patches_) {
      if (!(patch.restitution > 0)) continue;
      const double pull = pull_along(patch, relative_pull(patch)), rest = rest_of(patch);
      for (std::size_t k = patch.begin; k < patch.end; ++k) {
        Point& p = points_[k];
        const double into = -approach(patch, p), gap = std::max(p.now, 0.0);
        // As fast as it is when the gap is closed.
        const double coming = std::sqrt(std::max(into * std::fabs(into) + 2 * pull * gap, 0.0));
        p.flies = coming > rest && 2 * gap < FLIES * left * (into + coming);
        if (!p.flies) continue;
        p.force = p.across[0] = p.across[1] = 0;
        first = std::min(first, arrival(patch, p, share, first));
      }
    }
    return first;
  }

  // When a point closes its gap as bodies go on and turn, within a time: by false position, of
  // Illinois.
  double arrival(const Patch& patch, const Point& p, double share, double within) const {
    double low = 0, high = within, at_low = p.now, at_high = gap_at(patch, p, share, within);
    if (at_low <= 0) return 0;
    if (at_high > 0) return within;
    const double near = TOUCHING * world_.bodies[patch.a].reach / 8;
    for (int i = 0; i < ARRIVES && high - low > small_ * SOON / 4; ++i) {
      const double time = low + (high - low) * at_low / (at_low - at_high);
      const double gap = gap_at(patch, p, share, time);
      if (std::fabs(gap) < near) return time;
      if (gap > 0) {
        low = time, at_low = gap, at_high /= 2;
      } else {
        high = time, at_high = gap, at_low /= 2;
      }
    }
    return high;
  }

  double gap_at(const Patch& patch, const Point& p, double share, double time) const {
    const auto place = [&](std::size_t i, Vec own) {
      const State& s = states_[i];
      const Vec pulled = forces_[i] * (world_.bodies[i].ease * time * time / 2);
      const Vec arm = rotate(turn_of(speeds_[i].w * time), turns_[i].rotated(own));
      return s.at + s.velocity * time + pulled + arm;
    };
    const Vec own = place(patch.a, p.own);
    const Vec far = patch.b < count_
                        ? place(patch.b, p.other)
                        : patch.contact->motion->at(share + time / step_).to_world(p.other);
    return p.gap + dot(patch.normal, far - own) - patch.skin;
  }

  // Speed below which two do not bounce but rest: forces on either bring back what is slower
  // within a small step.
  double rest_of(std::size_t a, std::size_t b, double restitution) const {
    double pull = length(forces_[a]) * world_.bodies[a].ease;
    if (b < count_) pull = std::max(pull, length(forces_[b]) * world_.bodies[b].ease);
    return pull * small_ / (restitution > 0 ? restitution : 1);
  }
  double rest_of(const Patch& patch) const {
    return rest_of(patch.a, patch.b, patch.restitution);
  }

  // Where points are now.
  void look(double share) {
    for (Patch& patch : patches_) {
      const Vec at = states_[patch.a].at;
      const Pose& pose = turns_[patch.a];
      const bool fixed = patch.b == count_;
      const collide::Motion* motion = patch.contact->motion;
      const Pose other = fixed ? motion->at(share) : turns_[patch.b];
      for (std::size_t k = patch.begin; k < patch.end; ++k) {
        Point& p = points_[k];
        const Vec own = at + pose.rotated(p.own), far = other.to_world(p.other);
        p.now = p.gap + dot(patch.normal, far - own) - patch.skin;
        const Vec mid = touching_point(patch, own, far), off = mid - at - p.arm_a;
        const Vec far_off = fixed ? Vec{} : mid - states_[patch.b].at - p.arm_b;
        if (dot(off, off) + dot(far_off, far_off) > patch.turned) set_arms(patch, p, mid);
        if (fixed && motion->moves()) p.slide = motion->displacement(far, other) * (1 / step_);
        p.given = dot(p.slide, patch.normal);
      }
    }
  }

  // Acceleration of the second as the first sees it.
  Vec relative_pull(const Patch& patch) const {
    Vec pull = forces_[patch.a] * -world_.bodies[patch.a].ease;
    if (patch.b < count_) pull = pull + forces_[patch.b] * world_.bodies[patch.b].ease;
    return pull;
  }
  static double pull_along(const Patch& patch, Vec pull) { return -dot(pull, patch.normal); }

  double approach(const Patch& patch, const Point& p) const {
    return speed_along(speeds_, patch, p, 0);
  }

  // Forces act for half a small step.
  void push(std::size_t i) {
    State& s = states_[i];
    const double half = h_ / 2;
    s.velocity = s.velocity + forces_[i] * (world_.bodies[i].ease * half);
    s.momentum = s.momentum + torques_[i] * half;
    speeds_[i].v = s.velocity;
    speeds_[i].w = spin_of(world_.bodies[i], s);
  }

  void apply(std::size_t a, std::size_t b, Vec line, Vec turn_a, Vec turn_b, double impulse) {
    rigid::apply(speeds_, a, b, line, turn_a, turn_b, impulse);
  }

  // Contacts and joints hold for half the time what they held in the small step before.
  void begin_warm(Patch& patch, double scale) {
    for (std::size_t k = patch.begin; k < patch.end; ++k) {
      Point& p = points_[k];
      p.force *= scale / 2, p.across[0] *= scale / 2, p.across[1] *= scale / 2;
      p.half[0] = p.force, p.half[1] = p.across[0], p.half[2] = p.across[1];
      hold(patch, p);
    }
  }
  void end_warm(Patch& patch) {
    for (std::size_t k = patch.begin; k < patch.end; ++k) {
      Point& p = points_[k];
      if (p.force == 0) continue;
      p.force += p.half[0], p.across[0] += p.half[1], p.across[1] += p.half[2];
      hold(patch, p);
    }
  }
  void hold(const Patch& patch, const Point& p) {
    if (p.half[0] == 0) return;
    apply(patch.a, patch.b, patch.normal, p.turns_a[0], p.turns_b[0], p.half[0]);
    for (int d = 0; d < 2; ++d)
      apply(patch.a, patch.b, patch.tangents[d], p.turns_a[d + 1], p.turns_b[d + 1],
            p.half[d + 1]);
  }
  void begin_warm(const Joint& joint, Rows& rows, double scale) {
    for (std::size_t r = 0; r < rows.count; ++r) {
      Row& row = rows.of[r];
      row.half = row.impulse = row.impulse * (scale / 2);
    }
    hold(joint, rows);
  }
  void end_warm(const Joint& joint, Rows& rows) {
    for (std::size_t r = 0; r < rows.count; ++r) rows.of[r].impulse += rows.of[r].half;
    hold(joint, rows);
  }

  std::size_t first_of(const Joint& joint) const {
    return joint.a < 0 ? count_ : static_cast<std::size_t>(joint.a);
  }

  void hold(const Joint& joint, const Rows& rows) {
    const std::size_t a = first_of(joint);
    for (std::size_t r = 0; r < rows.count; ++r) {
      const Row& row = rows.of[r];
      if (row.half == 0) continue;
      apply(a, joint.b, row.line, speeds_[a].turned(row.arm_a),
            speeds_[joint.b].turned(row.arm_b), row.half);
    }
  }

  // The frames of a joint at a share of the step, and the arms to them.
  struct Frames {
    Anchor a, b;
    Vec arm_a, arm_b;
  };

  Frames frames_of(std::size_t number, double share, const State* on_a, const State& on_b) const {
    const Joint& joint = world_.joints[number];
    Frames found;
    if (joint.a < 0) {
      const Pose pose = anchors_[number].at(share);
      found.a = {pose.to_world(joint.on_a.at), unit(turn_of_pose(pose) * joint.on_a.turn), {}, {}};
      if (anchors_[number].moves()) {
        found.a.velocity = anchors_[number].displacement(found.a.at, pose) * (1 / step_);
        found.a.spin = anchors_[number].turn() * (1 / step_);
      }
    } else {
      found.a = anchor_of(*on_a, joint.on_a);
      found.arm_a = found.a.at - on_a->at;
    }
    found.b = anchor_of(on_b, joint.on_b);
    found.arm_b = found.b.at - on_b.at;
    return found;
  }

  const State* first_state(const Joint& joint) const {
    return joint.a < 0 ? nullptr : &states_[static_cast<std::size_t>(joint.a)];
  }

  void write_rows(std::size_t number, std::size_t k, double share, bool first) {
    const Joint& joint = world_.joints[number];
    std::array<double, ROWS> before{}, half{};
    if (first) {
      for (std::size_t i = 0; i < ROWS; ++i) before[i] = held_[number][i] * h_;
    } else {
      for (std::size_t r = 0; r < rows_[k].count; ++r) {
        const Row& row = rows_[k].of[r];
        before[static_cast<std::size_t>(row.slot)] = row.impulse;
        half[static_cast<std::size_t>(row.slot)] = row.half;
      }
    }
    const Frames f = frames_of(number, share, first_state(joint), states_[joint.b]);
    rows_[k] = rows_of(joint, f.a, f.b, f.arm_a, f.arm_b, speeds_[first_of(joint)],
                       speeds_[joint.b], h_);
    for (std::size_t r = 0; r < rows_[k].count; ++r) {
      Row& row = rows_[k].of[r];
      const auto slot = static_cast<std::size_t>(row.slot);
      row.impulse = std::clamp(before[slot], row.least, row.most), row.half = half[slot];
    }
  }

  // How much more a joint's errors change until the end of the small step than its equations
  // say, as bodies go on and turn: over the time.
  void bend(std::size_t number, Rows& rows, double end) {
    const Joint& joint = world_.joints[number];
    const auto gone = [&](std::size_t i) {
      State s = states_[i];
      s.at = s.at + speeds_[i].v * h_;
      s.momentum = momentum_of(i);
      turn_freely(i, s);
      return s;
    };
    const State on_b = gone(joint.b);
    const State on_a = joint.a < 0 ? State{} : gone(static_cast<std::size_t>(joint.a));
    const Frames f = frames_of(number, end, &on_a, on_b);
    const Rows after = rows_of(joint, f.a, f.b, f.arm_a, f.arm_b, speeds_[first_of(joint)],
                               speeds_[joint.b], h_);
    for (std::size_t r = 0; r < rows.count; ++r) {
      Row& row = rows.of[r];
      if (row.kind == Row::DRIVE) continue;
      for (std::size_t q = 0; q < after.count; ++q) {
        if (after.of[q].slot != row.slot) continue;
        const double change = after.of[q].error - row.error;
        const bool turns = dot(row.line, row.line) == 0;
        row.bend = (turns ? std::remainder(change, TURN) : change) / h_ - speed_of(joint, row);
      }
    }
  }

  double speed_of(const Joint& joint, const Row& row) const {
    const Speed &a = speeds_[first_of(joint)], &b = speeds_[joint.b];
    return dot(row.line, b.v - a.v) + dot(row.arm_b, b.w) - dot(row.arm_a, a.w) + row.given;
  }

  static Turn turn_of_pose(const Pose& pose) {
    const double* m = pose.turn;
    const double w = std::sqrt(std::max(0.0, 1 + m[0] + m[4] + m[8])) / 2;
    const double x = std::sqrt(std::max(0.0, 1 + m[0] - m[4] - m[8])) / 2;
    const double y = std::sqrt(std::max(0.0, 1 - m[0] + m[4] - m[8])) / 2;
    const double z = std::sqrt(std::max(0.0, 1 - m[0] - m[4] + m[8])) / 2;
    return {std::copysign(x, m[7] - m[5]), std::copysign(y, m[2] - m[6]),
            std::copysign(z, m[3] - m[1]), w};
  }

  static Anchor anchor_of(const State& s, const Frame& frame) {
    return {s.at + rotate(s.turn, frame.at), s.turn * frame.turn, {}, {}};
  }

  // Corrects velocities until they hardly change: with or without what pushes back to where
  // bodies should be.
  void iterate(const Island& island, bool pushing) {
    if (patches_.empty() && island.joints.empty()) return;
    const std::size_t size = points_.size() + island.joints.size() * 6;
    const int limit = settings_.rounds * static_cast<int>(std::clamp<std::size_t>(SMALL / std::max<std::size_t>(size, 1), 1, MOST));
    double change = 0;
    int round = 0;
    do {
      change = 0;
      for (std::size_t k = 0; k < island.joints.size(); ++k)
        change = std::max(change, correct(world_.joints[island.joints[k]], rows_[k], pushing));
      const std::size_t patches = patches_.size();
      // There and back, so that weight gets down and support gets up.
      for (std::size_t k = 0; k < patches; ++k)
        change = std::max(change, correct(patches_[round % 2 ? patches - 1 - k : k], pushing));
      ++round;
    } while (change > settings_.tolerance && round < limit);
    report_.rounds += round;
    if (!pushing) {
      report_.residual = std::max(report_.residual, change);
      if (change > settings_.tolerance) ++report_.unsolved;
    }
  }

  double correct(Patch& patch, bool pushing) {
    double most = 0;
    const double h = h_;
    for (std::size_t k = patch.begin; k < patch.end; ++k) {
      Point& p = points_[k];
      if (p.flies) continue;
      double bias = 0, mass = 1, leak = 0;
      if (p.now > 0) {
        // Who is on the way has not arrived: only places count.
        if (!pushing && p.force == 0) continue;
        bias = pushing ? p.now / h : 0;
      } else if (pushing) {
        bias = std::max(contact_.bias * p.now, -patch.push);
        mass = contact_.mass, leak = contact_.leak;
      }
      const double speed = approach(patch, p);
      const double change = -p.mass * mass * (speed + bias) - leak * p.force;
      const double force = std::max(p.force + change, 0.0), by = force - p.force;
      p.force = force;
      if (by != 0) {
        apply(patch.a, patch.b, patch.normal, p.turns_a[0], p.turns_b[0], by);
        most = std::max(most, std::fabs(by) / p.mass);
      }
    }
    if (!(patch.friction > 0)) return most;
    for (std::size_t k = patch.begin; k < patch.end; ++k) {
      Point& p = points_[k];
      if (p.force == 0 && p.across[0] == 0 && p.across[1] == 0) continue;
      const Speed &a = speeds_[patch.a], &b = speeds_[patch.b];
      const Vec off = b.v - a.v + p.slide;
      double to[2];
      for (int d = 0; d < 2; ++d) {
        const double speed = dot(patch.tangents[d], off) + dot(p.arms_b[d + 1], b.w) -
                             dot(p.arms_a[d + 1], a.w);
        to[d] = p.across[d] - p.masses[d] * speed;
      }
      const double limit = patch.friction * p.force;
      const double size = std::sqrt(to[0] * to[0] + to[1] * to[1]);
      const double share = size > limit ? limit / size : 1;
      for (int d = 0; d < 2; ++d) {
        const double by = to[d] * share - p.across[d];
        p.across[d] += by;
        if (by == 0) continue;
        apply(patch.a, patch.b, patch.tangents[d], p.turns_a[d + 1], p.turns_b[d + 1], by);
        most = std::max(most, std::fabs(by) / p.masses[d]);
      }
    }
    return most;
  }

  double correct(const Joint& joint, Rows& rows, bool pushing) {
    double most = 0;
    const std::size_t first = first_of(joint);
    Speed &a = speeds_[first], &b = speeds_[joint.b];
    for (std::size_t r = 0; r < rows.count; ++r) {
      Row& row = rows.of[r];
      const double speed = speed_of(joint, row) + (pushing ? row.bend : 0);
      double change = 0;
      if (row.kind == Row::DRIVE) {
        change = -(row.give * speed + row.push + row.impulse) / (1 + row.give / row.mass);
      } else if (row.kind == Row::LIMIT && row.error > 0) {
        change = -row.mass * (speed + row.error / h_);
      } else if (pushing) {
        const double back = std::clamp(joint_.bias * row.error, -PULL, PULL);
        const bool hard = hard_ && row.kind == Row::LOCK;
        change = -row.mass * (hard ? 1 : joint_.mass) * (speed + back) -
                 (hard ? 0 : joint_.leak) * row.impulse;
      } else {
        change = -row.mass * speed;
      }
      const double half = row.kind == Row::DRIVE && pushing ? 0.5 : 1;
      const double to = std::clamp(row.impulse + change, row.least * half, row.most * half);
      const double by = to - row.impulse;
      row.impulse = to;
      if (by == 0) continue;
      apply(first, joint.b, row.line, a.turned(row.arm_a), b.turned(row.arm_b), by);
      most = std::max(most, std::fabs(by) / row.mass);
    }
    return most;
  }

  // Bodies go on for a small step.
  void go(std::size_t i) {
    State& s = states_[i];
    const Body& body = world_.bodies[i];
    const Speed& speed = speeds_[i];
    s.at = s.at + speed.v * h_;
    if (pushed_[i]) s.velocity = speed.v, s.momentum = momentum_of(i);
    turn_freely(i, s);
    turns_[i] = pose_of(s);
    speeds_[i].w = spin_of(body, s);
    if (!patches_.empty() || !rows_.empty()) refresh(i);
  }

  void turn_freely(std::size_t i, State& s) const {
    const Vec p = unrotate(s.turn, s.momentum);
    Spin spin{s.turn, {p.x, p.y, p.z}};
    spin_freely(spin, world_.bodies[i].turning, h_, settings_.method);
    s.turn = spin.q;
    if (settings_.method != Method::SPLITTING)
      s.momentum = rotate(s.turn, {spin.p[0], spin.p[1], spin.p[2]});
  }

  Vec momentum_of(std::size_t i) const {
    const Vec w = turns_[i].unrotated(speeds_[i].w);
    const double* e = world_.bodies[i].turning.of;
    const double p[3] = {w.x, w.y, w.z};
    double to[3];
    for (int k = 0; k < 3; ++k) to[k] = e[k] > 0 ? p[k] / e[k] : 0.0;
    return turns_[i].rotated({to[0], to[1], to[2]});
  }

  // Notes whom contacts and joints push.
  void mark(const Island& island) {
    for (const std::size_t k : island.joints) {
      const Joint& joint = world_.joints[k];
      pushed_[joint.b] = 1;
      if (joint.a >= 0) pushed_[static_cast<std::size_t>(joint.a)] = 1;
    }
    for (const Patch& patch : patches_)
      for (std::size_t k = patch.begin; k < patch.end; ++k)
        if (points_[k].force > 0) {
          pushed_[patch.a] = 1;
          if (patch.b < count_) pushed_[patch.b] = 1;
        }
  }

  // Velocities as states have them.
  void settle(std::size_t i) {
    State& s = states_[i];
    if (!pushed_[i]) return;
    s.velocity = speeds_[i].v;
    s.momentum = momentum_of(i);
  }

  // ---- what is kept

  void keep() {
    const auto shapes = static_cast<std::int64_t>(world_.shapes.size());
    for (const Kept& one : kept_) {
      const bool both = sleeps(world_.shapes[static_cast<std::size_t>(one.first)].body) &&
                        (one.second >= shapes ||
                         sleeps(world_.shapes[static_cast<std::size_t>(one.second)].body));
      if (both) saved_.push_back(one);
    }
    std::stable_sort(saved_.begin(), saved_.end(), [](const Kept& a, const Kept& b) {
      return a.first != b.first ? a.first < b.first : a.second < b.second;
    });
    kept_ = std::move(saved_);
  }

  // Lets islands fall asleep that have been slow for long enough and that friction holds. What
  // nothing holds, or only a joint, goes on however slow it is, until it hardly moves at all.
  void rest() {
    for (const auto& island : islands_) {
      double speed = 0, least = std::numeric_limits<double>::infinity();
      bool held = !island.parting;
      for (const std::size_t i : island.bodies) {
        const State& s = states_[i];
        const double turning = length(spin_of(world_.bodies[i], s)) * world_.bodies[i].reach;
        const double own = length(s.velocity) + turning;
        speed = std::max(speed, own);
        const double share = held_at_[i] >= HELD ? 1 : held_at_[i] ? LEANING : CREEP;
        held &= own < settings_.drowsy * share && (held_at_[i] || supported(island));
      }
      for (const std::size_t i : island.bodies) {
        const bool slow = speed < settings_.drowsy && held;
        states_[i].idle = slow ? states_[i].idle + step_ : 0;
        least = std::min(least, states_[i].idle);
      }
      for (const std::size_t i : island.bodies) {
        states_[i].idle = std::min(states_[i].idle, std::max(least, settings_.rest / 2));
        if (least >= settings_.rest) states_[i].velocity = states_[i].momentum = {};
      }
    }
  }

  // Whether anything holds an island; without, it is at rest only where nothing pulls.
  bool supported(const Island& island) const {
    if (!island.contacts.empty() || !island.joints.empty()) return true;
    return std::all_of(island.bodies.begin(), island.bodies.end(), [&](std::size_t i) {
      const State& s = states_[i];
      const Vec sum = forces_[i] + torques_[i] + s.velocity + s.momentum;
      return dot(sum, sum) == 0;
    });
  }

  const World& world_;
  std::vector<State>& states_;
  std::vector<Kept>& kept_;
  std::vector<std::array<double, ROWS>>& held_;
  const std::vector<Vec>&forces_, &torques_;
  const std::vector<collide::Collider>& colliders_;
  const std::vector<collide::Motion>& anchors_;
  const Settings& settings_;
  double step_, small_, h_;  // whole, of small steps, and from impact to impact [s]
  std::size_t count_;
  Softness contact_ = Softness::of(STIFF / small_, CONTACT_DAMPING, h_);
  Softness joint_ = Softness::of(STIFF / small_, JOINT_DAMPING, h_);
  std::vector<Contact> contacts_;
  bool found_ = false;  // contacts, of this step
  std::vector<std::size_t> parents_;
  std::vector<Island> islands_;
  std::vector<Speed> speeds_;  // of the bodies, and of what does not move
  std::vector<Pose> turns_;
  std::vector<char> pushed_;
  std::vector<int> held_at_;  // points
  int parts_ = 1;  // small steps
  std::vector<Drives> drives_;
  bool hard_ = false;  // whether joints give way to nothing, so that drives move what they should
  bool bouncy_ = false;  // whether somebody may bounce
  std::vector<Patch> patches_;
  std::vector<Point> points_;
  std::vector<Rows> rows_;
  std::vector<Kept> saved_;
  Report report_;
};

}  // namespace

Report step_world(const World& world, std::vector<State>& states, std::vector<Kept>& kept,
                  std::vector<std::array<double, ROWS>>& held, const std::vector<Vec>& forces,
                  const std::vector<Vec>& torques,
                  const std::vector<collide::Collider>& colliders,
                  const std::vector<collide::Motion>& anchors, const Settings& settings,
                  double step) {
  Solver whole(world, states, kept, held, forces, torques, colliders, anchors, settings, step);
  if (settings.substeps == 1 || !whole.bounces()) return whole.run();
  // A body that bounces meets others than those that were in its way: contacts are found anew
  // in each small step.
  Settings small = settings;
  small.substeps = 1;
  std::vector<collide::Collider> around = colliders;
  std::vector<collide::Motion> frames = anchors;
  Report report;
  for (int s = 0; s < settings.substeps; ++s) {
    const double begin = static_cast<double>(s) / settings.substeps;
    const double end = static_cast<double>(s + 1) / settings.substeps;
    for (std::size_t i = 0; i < around.size(); ++i)
      around[i].motion = colliders[i].motion.part(begin, end);
    for (std::size_t i = 0; i < frames.size(); ++i) frames[i] = anchors[i].part(begin, end);
    report.add(Solver(world, states, kept, held, forces, torques, around, frames, small,
                      step / settings.substeps)
                   .run());
  }
  return report;
}

}  // namespace animtool::rigid
