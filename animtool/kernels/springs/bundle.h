// Four strands side by side over a frame, in small steps: compliant springs are projected one
// after the other, stiff springs along the strand are solved by a tridiagonal system.
//
// T.-H. Han, T. Harada, Tridiagonal Matrix Formulation for Inextensible Hair Strand
// Simulation, 2013; M. Macklin et al., Small Steps in Physics Simulation, 2019.
#pragma once

#include <cstddef>
#include <cstdint>

#include "colliders/wide.h"
#include "springs/rows.h"

namespace animtool {

// Queries of colliders other than rods, for one particle and the row (step, C): distance and
// direction out at the start or end of a step; and a test that stops fast particles.
struct OtherColliders {
  const void* all;
  void (*sample)(const void* all, std::size_t row, bool end, const double* point,
                 double* distance_and_normal);
  bool (*sweep)(const void* all, std::size_t row, const double* from, double* to);
};

struct StrandBundle;

// Collides segments of one of four strands with finer features in a step, for nearby particles.
// Returns whether any moved, and adds the displacements to their path lengths.
struct SegmentContacts {
  void* all = nullptr;  // null if no feature is that fine
  bool (*resolve)(void* all, StrandBundle& bundle, std::size_t step, std::size_t lane,
                  std::size_t near) = nullptr;
  double reach = 0;  // segments of a particle this far from all colliders cannot touch them
};

// Constants of a frame, shared by all strands.
struct StrandSteps {
  std::size_t points, cells, substeps;
  double h;
  double fall[3];      // velocity change by gravity in a step
  double drag_factor;  // factor of velocities by drag
  // Compliances: of folds, and of the fold at the root; of the pull to the animation, by
  // position and by velocity; of springs along the strand.
  double fold, root_fold, draw, draw_change, soft;
  double longest;  // largest length of springs along the strand, over their rest length
  std::size_t colliders;
  const collide::Rod* rods;  // (steps, C)
  // Which colliders are rods, and for which the displacement of the surface is known (C,).
  const unsigned char *is_rod, *is_bounded;
  std::size_t depth_rows;     // number of first colliders that have allowed depths
  const double* thicknesses;  // (C,)
  // Common drift of each step (steps, 3), and displacement of rod surfaces relative to it
  // from each step to the end of the frame (steps + 1, C).
  const double *drifts, *remaining;
  OtherColliders others;
  double tolerance;
};

// Four strands of P particles; vectors are (P, 3, 4).
struct StrandBundle {
  double *x, *before, *v;
  double* unmoved;  // positions relative to which particles that are moved out slowly are at rest
  const double* goals;  // (cells + 1, P, 3, 4)
  const double *rests, *folds;
  // Allowed depths: of each strand in the first collider, and the stride to the next one.
  const double* depths[WIDE];
  std::size_t next_depths;
  unsigned counted;  // bits of strands that are not padding
  // Buffers: vectors along each spring (P, 3, 4), and the matrix (P, 3, 4).
  double *along, *matrix;
  // Path length of each particle relative to the drift (P,), path lengths at which it may
  // touch any collider (P,), and each collider (P, C); nearby colliders (C,).
  double *shift, *due, *dues;
  std::size_t* near;
  SegmentContacts segments;
  std::int32_t* at_segments;  // those with a segment near a collider (P,)
  // Results: number of particles moved by colliders, summed over steps; number left inside;
  // the largest strain.
  std::int64_t* touched;
  std::int64_t inside;
  double stretch;
};

// Length corrections in a step; the first one covers all strands.
constexpr int CORRECTIONS = 4;
// Length corrections after collisions, each followed by more collisions.
constexpr int MAX_CONTACT_CORRECTIONS = 5;
// Iterations over all colliders.
constexpr int MAX_ITERATIONS = 3;
// Colliders farther away than this at the start of a frame are rarely touched in it [m].
constexpr double NEAR = 0.1;

template <class On>
class BundleSolver {
  using N = Four<On>;
  using V = FourVec<On>;

 public:
  BundleSolver(const StrandSteps& plan, StrandBundle& bundle) : plan_(plan), b_(bundle) {}

  void advance() {
    find_near_colliders();
    const double rate = 1 / plan_.h;
    for (std::size_t cell = 0; cell < plan_.cells; ++cell)
      for (std::size_t j = 0; j < plan_.substeps; ++j) {
        const double parts = static_cast<double>(plan_.substeps);
        first_ = b_.goals + cell * WIDE_VECTOR * plan_.points;
        begin_fraction_ = static_cast<double>(j) / parts;
        end_fraction_ = static_cast<double>(j + 1) / parts;
        predict();
        apply_folds();
        apply_pull();
        N some = less(N(0.0), N(1.0));
        for (int i = 0; i < CORRECTIONS && mask_bits(some); ++i) {
          correct<false>(some);
          some = too_long();
        }
        resolve_collisions(cell * plan_.substeps + j);
        for (std::size_t p = 0; p < plan_.points; ++p)
          ((at(b_.x, p) - at(b_.unmoved, p)) * rate).store(b_.v + WIDE_VECTOR * p);
      }
    b_.inside = left_inside();
    b_.stretch = longest();
  }

 private:
  static V at(const double* rows, std::size_t p) { return V::of(rows + WIDE_VECTOR * p); }

  // Animated position of a particle at a fraction of the cell; exact at both ends.
  V goal(std::size_t p, double fraction) const {
    return at(first_, p) * (1 - fraction) + at(first_ + WIDE_VECTOR * plan_.points, p) * fraction;
  }

  void predict() {
    const V fall = V::broadcast(plan_.fall);
    at(b_.x, 0).store(b_.before);
    at(b_.x, 0).store(b_.unmoved);
    goal(0, end_fraction_).store(b_.x);
    for (std::size_t p = 1; p < plan_.points; ++p) {
      const V x = at(b_.x, p);
      x.store(b_.before + WIDE_VECTOR * p);
      x.store(b_.unmoved + WIDE_VECTOR * p);
      const V v = (at(b_.v, p) + fall) * plan_.drag_factor;
      (x + v * plan_.h).store(b_.x + WIDE_VECTOR * p);
    }
  }

  void apply_folds() {
    if (plan_.fold == 0) return;
    for (std::size_t p = 0; p + 2 < plan_.points; ++p) {
      const V a = at(b_.x, p), b = at(b_.x, p + 2), d = b - a;
      const N square = dot(d, d), rest = N::of(b_.folds + WIDE * p);
      // Coincident ends have no direction, and no force.
      const N one = select(less(N(0.0), square), N(1.0), N(0.0));
      const N beyond = one - rest * (sqrt(square) * inverse(square));
      const V pull = d * (beyond * (p == 0 ? plan_.root_fold : plan_.fold));
      if (p > 0) (a + pull).store(b_.x + WIDE_VECTOR * p);
      (b - pull).store(b_.x + WIDE_VECTOR * (p + 2));
    }
  }

  void apply_pull() {
    if (plan_.draw == 0) return;
    for (std::size_t p = 1; p < plan_.points; ++p) {
      const V x = at(b_.x, p), off = goal(p, end_fraction_) - x;
      const V displacement = off - (goal(p, begin_fraction_) - at(b_.before, p));
      (x + off * plan_.draw + displacement * plan_.draw_change).store(b_.x + WIDE_VECTOR * p);
    }
  }

  // Which strands have a spring above its largest length: those that rotate far in a step.
  N too_long() const {
    N hit = less(N(0.0), N(0.0));
    for (std::size_t p = 1; p < plan_.points; ++p) {
      const V d = at(b_.x, p) - at(b_.x, p - 1);
      const N most = N::of(b_.rests + WIDE * (p - 1)) * plan_.longest;
      hit = mask_or(hit, less(most * most, dot(d, d)));
    }
    return hit;
  }

  // One Newton correction of all lengths along some of the strands. Each spring moves its
  // neighbours, so that the matrix is tridiagonal. Optionally records the displacements.
  template <bool Recorded>
  void correct(const N& some) {
    V before{0.0, 0.0, 0.0};
    N fraction(0.0), sum(0.0);
    for (std::size_t p = 1; p < plan_.points; ++p) {
      const V d = at(b_.x, p) - at(b_.x, p - 1);
      const N size = length(d);
      const V along = d * inverse(size);
      // Coupling of springs that share a particle; the root does not move.
      const N shared = dot(before, along);
      const N full = N((p == 1 ? 1 : 2) + plan_.soft) - shared * shared * fraction;
      sum = size - N::of(b_.rests + WIDE * (p - 1)) + shared * fraction * sum;
      fraction = N(1.0) / full;
      along.store(b_.along + WIDE_VECTOR * p);
      double* row = b_.matrix + WIDE_VECTOR * p;
      shared.store(row);
      fraction.store(row + WIDE);
      sum.store(row + 2 * WIDE);
      before = along;
    }
    N pull(0.0), shared(0.0);
    V behind{0.0, 0.0, 0.0};
    for (std::size_t p = plan_.points; p-- > 1;) {
      const double* row = b_.matrix + WIDE_VECTOR * p;
      pull = (N::of(row + 2 * WIDE) + shared * pull) * N::of(row + WIDE);
      shared = N::of(row);
      const V back = at(b_.along, p) * pull;
      const V x = at(b_.x, p), move = select(some, behind - back, V{0.0, 0.0, 0.0});
      (x + move).store(b_.x + WIDE_VECTOR * p);
      if constexpr (Recorded) b_.shift[p] += largest(length(move));
      behind = back;
    }
  }

  static N length(const V& a) { return sqrt(dot(a, a)); }

  // In which of four parts of the strands, from root to tip, a point is.
  std::size_t part(std::size_t p) const { return p * WIDE / plan_.points; }

  // Bounding ball of each part of all strands: centre and radius. Returns which parts exist:
  // strands with few points do not have all.
  unsigned bound_parts(V& centre, N& radius) const {
    unsigned parts = 0;
    double low[3][WIDE], high[3][WIDE];
    for (std::size_t k = 0; k < 3; ++k)
      for (std::size_t g = 0; g < WIDE; ++g) low[k][g] = UNREACHED, high[k][g] = -UNREACHED;
    for (std::size_t p = 0; p < plan_.points; ++p) {
      const std::size_t g = part(p);
      parts |= 1u << g;
      for (std::size_t k = 0; k < 3; ++k) {
        const N row = N::of(b_.x + WIDE_VECTOR * p + WIDE * k);
        const double least = smallest(row), most = largest(row);
        low[k][g] = least < low[k][g] ? least : low[k][g];
        high[k][g] = most > high[k][g] ? most : high[k][g];
      }
    }
    const V from = V::of(low[0]), half = (V::of(high[0]) - from) * 0.5;
    centre = from + half;
    radius = length(half);
    return parts;
  }

  // Distances of the parts of the strands from each collider at the start of the frame.
  void find_near_colliders() {
    near_ = 0;
    far_ = UNREACHED;
    if (plan_.colliders == 0) return;
    V centre;
    N radius;
    const unsigned parts = bound_parts(centre, radius);
    for (std::size_t c = 0; c < plan_.colliders; ++c) {
      double off[WIDE] = {0, 0, 0, 0};
      if (plan_.is_rod[c]) {
        const collide::Rod& rod = plan_.rods[c];
        const N away = sample_rod(rod.begin, rod.radius, centre).distance - radius;
        (max(away, N(0.0)) - plan_.remaining[c]).store(off);
      }
      double nearest = UNREACHED;
      for (std::size_t g = 0; g < WIDE; ++g)
        if ((parts >> g & 1) && off[g] < nearest) nearest = off[g];
      if (nearest >= NEAR) {
        far_ = nearest < far_ ? nearest : far_;
        continue;
      }
      b_.near[near_++] = c;
      for (std::size_t p = 0; p < plan_.points; ++p)
        b_.dues[p * plan_.colliders + c] = off[part(p)];
    }
    for (std::size_t p = 0; p < plan_.points; ++p) {
      b_.shift[p] = 0;
      b_.due[p] = next_due(p);
    }
  }

  // Path length at which a particle may touch the next collider.
  double next_due(std::size_t p) const {
    const double* dues = b_.dues + p * plan_.colliders;
    double next = far_;
    for (std::size_t k = 0; k < near_; ++k) {
      const double one = dues[b_.near[k]];
      next = one < next ? one : next;
    }
    return next;
  }

  // Colliders come last in each step; strands that they stretched are corrected before.
  void resolve_collisions(std::size_t step) {
    if (plan_.colliders == 0) return;
    const V drift = V::broadcast(plan_.drifts + 3 * step);
    for (std::size_t p = 1; p < plan_.points; ++p)
      b_.shift[p] += largest(length(at(b_.x, p) - at(b_.before, p) - drift));
    unsigned touched = 0;
    select_strands(ALL);
    unsigned moved = collide_particles(step, touched);
    b_.touched[step] += touched;
    for (int i = 0; i < MAX_CONTACT_CORRECTIONS && moved; ++i) {
      moved &= mask_bits(too_long());
      if (!moved) break;
      select_strands(moved);
      correct<true>(selected_);
      moved &= collide_particles(step, touched);
    }
  }

  // Moves some of the strands out of colliders.
  void select_strands(unsigned some) {
    double lanes[WIDE];
    for (std::size_t l = 0; l < WIDE; ++l) lanes[l] = some >> l & 1;
    selected_ = less(N(0.0), N::of(lanes));
    selected_bits_ = some;
  }

  // Moves particles out of colliders; returns in which strands.
  unsigned collide_particles(std::size_t step, unsigned& touched) {
    unsigned lanes = 0;
    for (std::size_t p = 1; p < plan_.points; ++p) {
      if (b_.shift[p] < b_.due[p]) continue;
      if (b_.shift[p] >= far_) include_all_colliders();
      const double displacement = largest(length(at(b_.x, p) - at(b_.before, p)));
      const unsigned moved = resolve(step, p, displacement);
      touched += count(moved);
      lanes |= moved;
    }
    return b_.segments.all ? lanes | collide_segments(step) : lanes;
  }

  // The same for segments between particles; the root counts as near if any particle is.
  unsigned collide_segments(std::size_t step) {
    std::size_t near = 0;
    b_.at_segments[near++] = 0;
    for (std::size_t p = 1; p < plan_.points; ++p)
      if (b_.shift[p] + b_.segments.reach >= b_.due[p])
        b_.at_segments[near++] = static_cast<std::int32_t>(p);
    unsigned lanes = 0;
    for (std::size_t l = 0; near > 1 && l < WIDE; ++l) {
      if (!((selected_bits_ & b_.counted) >> l & 1)) continue;
      if (b_.segments.resolve(b_.segments.all, b_, step, l, near)) lanes |= 1u << l;
    }
    return lanes;
  }

  void include_all_colliders() {
    const std::size_t count = plan_.colliders;
    for (std::size_t c = 0; c < count; ++c) {
      bool known = false;
      for (std::size_t k = 0; k < near_; ++k) known = known || b_.near[k] == c;
      for (std::size_t p = 0; !known && p < plan_.points; ++p) b_.dues[p * count + c] = 0;
    }
    for (near_ = 0; near_ < count; ++near_) b_.near[near_] = near_;
    for (std::size_t p = 0; p < plan_.points; ++p) b_.due[p] = 0;
    far_ = UNREACHED;
  }

  unsigned count(unsigned bits) const {
    unsigned hit = 0;
    for (bits &= b_.counted; bits; bits &= bits - 1) ++hit;
    return hit;
  }

  // Moves four particles out of colliders; returns which were moved.
  unsigned resolve(std::size_t step, std::size_t p, double displacement) {
    double &shift = b_.shift[p], *dues = b_.dues + p * plan_.colliders;
    const V from = at(b_.before, p);
    V to = at(b_.x, p), unmoved = at(b_.unmoved, p);
    unsigned moved = sweep(step, p, displacement, from, to);
    for (int round = 0; round < MAX_ITERATIONS; ++round) {
      unsigned pushed = 0;
      std::size_t tested = 0, only = 0;
      for (std::size_t k = 0; k < near_; ++k) {
        const std::size_t c = b_.near[k];
        if (dues[c] > shift) continue;
        ++tested;
        only = c;
        pushed |= push(step, p, c, from, to, unmoved);
      }
      // A particle that is pushed may come near colliders that were far away.
      if (shift >= far_) include_all_colliders();
      moved |= pushed;
      if (!pushed || (tested == 1 && !any_due(dues, shift, only))) break;
    }
    b_.due[p] = next_due(p);
    to.store(b_.x + WIDE_VECTOR * p);
    unmoved.store(b_.unmoved + WIDE_VECTOR * p);
    return moved;
  }

  bool any_due(const double* dues, double shift, std::size_t but) const {
    for (std::size_t k = 0; k < near_; ++k)
      if (b_.near[k] != but && dues[b_.near[k]] <= shift) return true;
    return false;
  }

  unsigned push(std::size_t step, std::size_t p, std::size_t c, const V& from, V& to, V& unmoved) {
    const std::size_t row = step * plan_.colliders + c;
    const collide::Rod& rod = plan_.rods[row];
    double &shift = b_.shift[p], &due = b_.dues[p * plan_.colliders + c];
    const auto hit = sample(row, c, true, to);
    const double remaining = plan_.remaining[row + plan_.colliders];
    const double nearest = smallest(hit.distance);
    due = plan_.is_bounded[c] && nearest > remaining ? shift + (nearest - remaining) : shift;
    if (!(nearest < -collide::TOUCH)) return 0;
    const N depth = depths(p, c);
    if (!(smallest(hit.distance - depth) < -collide::TOUCH)) return 0;
    const N begun = sample(row, c, false, from).distance;
    V location = to, rest_position = unmoved;
    const unsigned pushed =
        selected_bits_ & collide::push_out(rod, hit, begun, depth, from, location, rest_position);
    if (!pushed) return 0;
    location = select(selected_, location, to);
    unmoved = select(selected_, rest_position, unmoved);
    shift += largest(length(location - to));
    due = shift;
    to = location;
    return pushed;
  }

  N depths(std::size_t p, std::size_t c) const {
    if (!b_.depths[0] || c >= plan_.depth_rows) return N(0.0);
    double hit[WIDE];
    for (std::size_t l = 0; l < WIDE; ++l) hit[l] = b_.depths[l][c * b_.next_depths + p];
    return N::of(hit);
  }

  collide::WideSample<N> sample(std::size_t row, std::size_t c, bool end, const V& at) const {
    const collide::Rod& rod = plan_.rods[row];
    if (plan_.is_rod[c]) return collide::sample_rod(end ? rod.end : rod.begin, rod.radius, at);
    double points[WIDE_VECTOR], answers[WIDE][WIDE];
    at.store(points);
    for (std::size_t l = 0; l < WIDE; ++l) {
      const double point[3] = {points[l], points[WIDE + l], points[2 * WIDE + l]};
      plan_.others.sample(plan_.others.all, row, end, point, answers[l]);
    }
    double columns[WIDE][WIDE];
    for (std::size_t k = 0; k < WIDE; ++k)
      for (std::size_t l = 0; l < WIDE; ++l) columns[k][l] = answers[l][k];
    return {N::of(columns[0]), {N::of(columns[1]), N::of(columns[2]), N::of(columns[3])}};
  }

  // Stops particles that move farther than the thickness of colliders (continuous collision).
  unsigned sweep(std::size_t step, std::size_t p, double displacement, const V& from, V& to) {
    double &shift = b_.shift[p], *dues = b_.dues + p * plan_.colliders;
    unsigned stopped = 0;
    for (std::size_t k = 0; k < near_; ++k) {
      const std::size_t c = b_.near[k];
      if (dues[c] > shift || displacement <= plan_.thicknesses[c]) continue;
      double begins[WIDE_VECTOR], ends[WIDE_VECTOR];
      from.store(begins);
      to.store(ends);
      for (std::size_t l = 0; l < WIDE; ++l) {
        const double begin[3] = {begins[l], begins[WIDE + l], begins[2 * WIDE + l]};
        double end[3] = {ends[l], ends[WIDE + l], ends[2 * WIDE + l]};
        const std::size_t row = step * plan_.colliders + c;
        if (!(selected_bits_ >> l & 1)) continue;
        if (!plan_.others.sweep(plan_.others.all, row, begin, end)) continue;
        for (std::size_t k = 0; k < 3; ++k) ends[k * WIDE + l] = end[k];
        stopped |= 1u << l;
      }
      const V location = V::of(ends);
      shift += largest(length(location - to));
      to = location;
    }
    return stopped;
  }

  std::int64_t left_inside() const {
    std::int64_t inside = 0;
    const std::size_t steps = plan_.cells * plan_.substeps;
    for (std::size_t p = 1; p < plan_.points; ++p) {
      unsigned deep = 0;
      for (std::size_t k = 0; k < near_; ++k) {
        const std::size_t c = b_.near[k];
        if (b_.dues[p * plan_.colliders + c] > b_.shift[p]) continue;
        const std::size_t row = (steps - 1) * plan_.colliders + c;
        const N off = sample(row, c, true, at(b_.x, p)).distance - depths(p, c);
        deep |= mask_bits(less(off, N(-plan_.tolerance)));
      }
      inside += count(deep);
    }
    return inside;
  }

  double longest() const {
    N largest_strain(0.0);
    for (std::size_t p = 1; p < plan_.points; ++p) {
      const V d = at(b_.x, p) - at(b_.x, p - 1);
      const N rest = N::of(b_.rests + WIDE * (p - 1));
      const N beyond = sqrt(dot(d, d)) * inverse(rest) - 1.0;
      largest_strain = max(beyond, largest_strain);
    }
    return largest(largest_strain);
  }

  static constexpr double UNREACHED = 1e300;
  static constexpr unsigned ALL = 15;

  const StrandSteps& plan_;
  StrandBundle& b_;
  // Animated positions of the strands at the start and the end of the current cell; fractions
  // of the cell at the start and the end of the step.
  const double* first_ = nullptr;
  double begin_fraction_ = 0, end_fraction_ = 0;
  // Number of nearby colliders, and the path length at which any other may be touched.
  std::size_t near_ = 0;
  double far_ = 0;
  // The strands that colliders may move.
  N selected_{0.0};
  unsigned selected_bits_ = 0;
};

template <class On>
void advance_bundle(const StrandSteps& plan, StrandBundle& bundle) {
  BundleSolver<On>(plan, bundle).advance();
}

}  // namespace animtool
