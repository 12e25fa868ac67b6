// Contacts of a surface of springs with itself.
#include "springs_self.h"

#include <algorithm>
#include <limits>
#include <queue>
#include <stdexcept>

#include "collide_mesh.h"
#include "springs_steps.h"

namespace animtool {

namespace {

using collide::Shares;
using collide::Vec;
using collide::load;
using collide::shares_of_triangle;
using collide::store;

// Pairs nearer at rest, along the surface, are kept apart by springs [thickness].
constexpr double NEIGHBOURS = 1.5;
// Ways along edges are so much longer than straight ones, at most.
constexpr double DETOUR = 2;
// Of a way in a step, over that of all, what is looked at for crossings [thickness].
constexpr double FASTEST = 4;
// Steps that a list of candidates is made for, and bounds of its margin [thickness].
constexpr double STEPS_AHEAD = 8, LEAST_MARGIN = 0.25, MOST_MARGIN = 1;
// Beyond a triangle's sides, what still counts as through it [1].
constexpr double BRIM = 1e-6;
// Cells are counted to this from the first in each direction.
constexpr std::int64_t MOST_CELLS = (1 << 20) - 1;
constexpr double INFINITE = std::numeric_limits<double>::infinity();

struct Triangle {
  Vec a, b, c;

  Triangle(const std::int32_t* corners, const double* rows)
      : a(load(rows + ROW * static_cast<std::size_t>(corners[0]))),
        b(load(rows + ROW * static_cast<std::size_t>(corners[1]))),
        c(load(rows + ROW * static_cast<std::size_t>(corners[2]))) {}
  Triangle(Vec a0, Vec b0, Vec c0) : a(a0), b(b0), c(c0) {}

  Shares shares(Vec p) const { return shares_of_triangle(p, a, b, c); }
  Vec at(const Shares& shares) const { return a + (b - a) * shares.b + (c - a) * shares.c; }
  double distance(Vec p) const { return length(p - at(shares(p))); }
  // Of no length where it has no area.
  Vec normal() const { return direction(cross(b - a, c - a), Vec{}); }
  double height(Vec p) const { return dot(p - a, normal()); }
};

Vec row_of(const std::vector<double>& rows, std::int32_t particle) {
  return load(rows.data() + ROW * static_cast<std::size_t>(particle));
}

bool has_corner(const std::int32_t* corners, std::int32_t particle) {
  return corners[0] == particle || corners[1] == particle || corners[2] == particle;
}

bool by_triangle(const Passage& a, const Passage& b) {
  return std::pair(a.triangle, a.particle) < std::pair(b.triangle, b.particle);
}

Vec between(Vec a, Vec b, double share) { return a + (b - a) * share; }

// From which side (1 or -1) a particle went through a triangle, both on straight ways; 0
// where it did not.
std::int32_t crossed_from(Vec from, Vec to, const Triangle& was, const Triangle& is) {
  const double first = was.height(from), last = is.height(to);
  if ((first >= 0) == (last >= 0) || !(std::abs(first - last) > 0)) return 0;
  const double share = first / (first - last);
  const Triangle then{between(was.a, is.a, share), between(was.b, is.b, share),
                      between(was.c, is.c, share)};
  const Vec p = between(from, to, share);
  const Vec ab = then.b - then.a, ac = then.c - then.a, ap = p - then.a;
  const double bb = dot(ab, ab), bc = dot(ab, ac), cc = dot(ac, ac);
  const double area = bb * cc - bc * bc;
  if (!(area > 0)) return 0;
  const double b = (cc * dot(ap, ab) - bc * dot(ap, ac)) / area;
  const double c = (bb * dot(ap, ac) - bc * dot(ap, ab)) / area;
  if (b < -BRIM || c < -BRIM || b + c > 1 + BRIM) return 0;
  return first >= 0 ? 1 : -1;
}

// Neighbours of particles along edges and springs, with the length of the way.
class Ways {
 public:
  Ways(const SpringNetwork& network, const std::vector<double>& rest)
      : beside_(network.particles()), away_(network.particles(), INFINITE) {
    const auto join = [&](std::int32_t i, std::int32_t j) {
      const double way = length(row_of(rest, i) - row_of(rest, j));
      beside_[static_cast<std::size_t>(i)].push_back({j, way});
      beside_[static_cast<std::size_t>(j)].push_back({i, way});
    };
    const auto& corners = network.triangles;
    for (std::size_t t = 0; t < corners.size(); t += 3)
      for (std::size_t k = 0; k < 3; ++k) join(corners[t + k], corners[t + (k + 1) % 3]);
    for (const Spring& spring : network.lines.springs) join(spring.i, spring.j);
  }

  // Particles that are no farther from the corners of a triangle than this, those included.
  const std::vector<std::int32_t>& around(const std::int32_t* corners, double farthest) {
    for (const std::int32_t n : found_) away(n) = INFINITE;
    found_.clear();
    using Way = std::pair<double, std::int32_t>;
    std::priority_queue<Way, std::vector<Way>, std::greater<Way>> waiting;
    const auto reach = [&](std::int32_t n, double way) {
      if (way > farthest || way >= away(n)) return;
      if (away(n) == INFINITE) found_.push_back(n);
      away(n) = way;
      waiting.push({way, n});
    };
    for (std::size_t k = 0; k < 3; ++k) reach(corners[k], 0);
    while (!waiting.empty()) {
      const auto [way, n] = waiting.top();
      waiting.pop();
      if (way > away(n)) continue;
      for (const auto& [next, step] : beside_[static_cast<std::size_t>(n)])
        reach(next, way + step);
    }
    return found_;
  }

 private:
  double& away(std::int32_t n) { return away_[static_cast<std::size_t>(n)]; }

  std::vector<std::vector<std::pair<std::int32_t, double>>> beside_;
  std::vector<double> away_;
  std::vector<std::int32_t> found_;
};

// A box about a triangle and what is near it.
struct Box {
  double low[3], high[3];

  Box(const Triangle& t, double reach) {
    const double a[3] = {t.a.x, t.a.y, t.a.z}, b[3] = {t.b.x, t.b.y, t.b.z},
                 c[3] = {t.c.x, t.c.y, t.c.z};
    for (std::size_t k = 0; k < 3; ++k) {
      low[k] = std::min({a[k], b[k], c[k]}) - reach;
      high[k] = std::max({a[k], b[k], c[k]}) + reach;
    }
  }

  double widest() const {
    return std::max({high[0] - low[0], high[1] - low[1], high[2] - low[2]});
  }
  // Whether a point is inside, or no farther from it along any axis.
  bool has(const double* p, double more = 0) const {
    return p[0] >= low[0] - more && p[0] <= high[0] + more && p[1] >= low[1] - more &&
           p[1] <= high[1] + more && p[2] >= low[2] - more && p[2] <= high[2] + more;
  }
  // How far a point is outside.
  double distance(const double* p) const {
    double off[3];
    for (std::size_t k = 0; k < 3; ++k)
      off[k] = std::max({low[k] - p[k], 0.0, p[k] - high[k]});
    return std::sqrt(dot3(off, off));
  }
};

// Puts particles in cells that fit triangles with what is near them.
void fill_grid(ParticleGrid& grid, const SpringLayers& layers, const std::vector<double>& x,
               double reach) {
  double widest = 0;
  for (std::size_t t = 0; t < layers.triangles(); ++t)
    widest += Box(Triangle(layers.corners(t), x.data()), reach).widest();
  const double cell = widest / static_cast<double>(std::max<std::size_t>(layers.triangles(), 1));
  grid.build(x.data(), layers.particles(), cell / 2);
}

// Calls with each triangle and particle that may be no farther apart.
template <class Function>
void visit_pairs(const ParticleGrid& grid, const SpringLayers& layers,
                 const std::vector<double>& x, double reach, Function function) {
  for (std::size_t t = 0; t < layers.triangles(); ++t) {
    const std::int32_t* corners = layers.corners(t);
    const Triangle triangle(corners, x.data());
    const Box box(triangle, reach);
    const Vec centre = (triangle.a + triangle.b + triangle.c) * (1.0 / 3);
    const double radius = std::max({length(triangle.a - centre), length(triangle.b - centre),
                                    length(triangle.c - centre)}) + reach;
    grid.visit(box.low, box.high, [&](std::int32_t n, const double* place) {
      if (!box.has(place)) return;
      const Vec p = load(place), off = p - centre;
      if (dot(off, off) > radius * radius || has_corner(corners, n)) return;
      function(t, n, triangle, p);
    });
  }
}

}  // namespace

void ParticleGrid::build(const double* rows, std::size_t count, double cell) {
  count_ = count;
  std::size_t size = 16;
  while (size < 2 * count) size *= 2;
  mask_ = size - 1;
  over_ = 1 / cell;
  for (std::size_t k = 0; k < 3; ++k) low_[k] = count ? rows[k] : 0;
  for (std::size_t n = 0; n < count; ++n)
    for (std::size_t k = 0; k < 3; ++k) low_[k] = std::min(low_[k], rows[ROW * n + k]);
  std::vector<std::uint64_t> keys(count);
  starts_.assign(size + 1, 0);
  for (std::size_t n = 0; n < count; ++n) {
    std::int64_t at[3];
    for (std::size_t k = 0; k < 3; ++k) at[k] = cell_of(rows[ROW * n + k], k);
    keys[n] = key(at);
    ++starts_[bucket(keys[n]) + 1];
  }
  for (std::size_t b = 0; b < size; ++b) starts_[b + 1] += starts_[b];
  keys_.resize(count);
  particles_.resize(count);
  places_.resize(ROW * count);
  std::vector<std::uint32_t> next(starts_.begin(), starts_.end() - 1);
  for (std::size_t n = 0; n < count; ++n) {
    const std::size_t to = next[bucket(keys[n])]++;
    keys_[to] = keys[n];
    particles_[to] = static_cast<std::int32_t>(n);
    std::copy_n(rows + ROW * n, ROW, places_.data() + ROW * to);
  }
}

std::int64_t ParticleGrid::cell_of(double place, std::size_t axis) const {
  const double cell = std::floor((place - low_[axis]) * over_);
  return static_cast<std::int64_t>(std::clamp(cell, 0.0, double(MOST_CELLS)));
}

std::uint64_t ParticleGrid::key(const std::int64_t* cell) const {
  return static_cast<std::uint64_t>(cell[0]) | static_cast<std::uint64_t>(cell[1]) << 20 |
         static_cast<std::uint64_t>(cell[2]) << 40;
}

std::size_t ParticleGrid::bucket(std::uint64_t key) const {
  return static_cast<std::size_t>((key * 0x9e3779b97f4a7c15u) >> 32) & mask_;
}

template <class Function>
void ParticleGrid::visit(const double* low, const double* high, Function function) const {
  std::int64_t first[3], last[3];
  double cells = 1;
  for (std::size_t k = 0; k < 3; ++k) {
    first[k] = cell_of(low[k], k);
    last[k] = cell_of(high[k], k);
    cells *= static_cast<double>(last[k] - first[k] + 1);
  }
  // A box of more cells than there are particles is looked through faster without them.
  if (cells > static_cast<double>(count_)) {
    for (std::size_t i = 0; i < count_; ++i) function(particles_[i], &places_[ROW * i]);
    return;
  }
  std::int64_t at[3];
  for (at[2] = first[2]; at[2] <= last[2]; ++at[2])
    for (at[1] = first[1]; at[1] <= last[1]; ++at[1])
      for (at[0] = first[0]; at[0] <= last[0]; ++at[0]) {
        const std::uint64_t wanted = key(at);
        const std::size_t b = bucket(wanted);
        for (std::size_t i = starts_[b]; i < starts_[b + 1]; ++i)
          if (keys_[i] == wanted) function(particles_[i], &places_[ROW * i]);
      }
}

SpringLayers::SpringLayers(const SpringNetwork& network, In<double, 2> rest,
                           double thickness0, double friction0, double speed0)
    : thickness(thickness0),
      friction(friction0),
      speed(speed0),
      particles_(network.particles()),
      corners_(network.triangles),
      neighbour_starts_{0},
      near_(network.triangles.size() / 3) {
  if (rest.shape(0) != particles_ || rest.shape(1) != 3)
    throw std::invalid_argument("what is at rest is (N, 3)");
  std::vector<double> rows(ROW * particles_);
  for (std::size_t n = 0; n < particles_; ++n)
    std::copy_n(rest.data() + 3 * n, 3, rows.data() + ROW * n);
  note_neighbours(network, rows);
  note_near(rows);
}

void SpringLayers::note_neighbours(const SpringNetwork& network,
                                   const std::vector<double>& rest) {
  Ways ways(network, rest);
  const double near = NEIGHBOURS * thickness;
  for (std::size_t t = 0; t < triangles(); ++t) {
    const Triangle triangle(corners(t), rest.data());
    const double side = std::max({length(triangle.b - triangle.a), length(triangle.c - triangle.b),
                                  length(triangle.a - triangle.c)});
    for (const std::int32_t n : ways.around(corners(t), DETOUR * near + side))
      if (has_corner(corners(t), n) || triangle.distance(row_of(rest, n)) < near)
        neighbours_.push_back(n);
    neighbour_starts_.push_back(neighbours_.size());
  }
}

void SpringLayers::note_near(const std::vector<double>& rest) {
  ParticleGrid grid;
  fill_grid(grid, *this, rest, thickness);
  visit_pairs(grid, *this, rest, thickness,
              [&](std::size_t t, std::int32_t n, const Triangle& triangle, Vec p) {
                const double apart = triangle.distance(p);
                if (apart < least(t, n)) near_[t].push_back({n, apart});
              });
}

double SpringLayers::least(std::size_t triangle, std::int32_t particle) const {
  int neighbour = 0;
  const std::size_t last = neighbour_starts_[triangle + 1];
  for (std::size_t i = neighbour_starts_[triangle]; i < last; ++i)
    neighbour |= neighbours_[i] == particle;
  if (neighbour) return 0;
  for (const auto& [n, apart] : near_[triangle])
    if (n == particle) return apart;
  return thickness;
}

SelfContacts::SelfContacts(const SpringLayers& layers, const SpringNetwork& network)
    : layers_(&layers), network_(network) {}

SelfContacts::SelfContacts(const SpringLayers* layers, const SpringNetwork& network,
                           const In<std::int64_t, 2>& crossed)
    : layers_(layers), network_(network) {
  if (layers_ && layers_->particles() != network.particles())
    throw std::invalid_argument("layers are of as many particles as there are");
  if (crossed.shape(1) != 3) throw std::invalid_argument("passages are (C, 3)");
  const auto within = [](std::int64_t n, std::size_t count) {
    return n >= 0 && n < static_cast<std::int64_t>(count);
  };
  for (std::size_t c = 0; c < crossed.size(); c += 3) {
    const std::int64_t* one = crossed.data() + c;
    if (!layers_ || !within(one[0], layers_->particles()) ||
        !within(one[1], layers_->triangles()) || std::abs(one[2]) != 1)
      throw std::invalid_argument("passages are of particles, triangles, and 1 or -1");
    crossed_.push_back({static_cast<std::int32_t>(one[0]), static_cast<std::int32_t>(one[1]),
                        static_cast<std::int32_t>(one[2])});
  }
  std::sort(crossed_.begin(), crossed_.end(), by_triangle);
}

void SelfContacts::begin_cell(std::int64_t cell) {
  if (cell == cell_)
    crossed_ = begun_;
  else
    begun_ = crossed_;
  cell_ = cell;
}

bool SelfContacts::measure(double h, const std::vector<double>& before, const std::vector<double>& x) {
  const std::size_t count = layers_->particles();
  const bool listed = listed_ >= 0;
  Vec way, off;
  for (std::size_t n = 0; n < ROW * count; n += ROW) {
    way = way + (load(&x[n]) - load(&before[n]));
    if (listed) off = off + (load(&x[n]) - load(&listed_at_[n]));
  }
  way = way * (1.0 / static_cast<double>(count));
  off = off * (1.0 / static_cast<double>(count));
  double fastest = 0, farthest = 0;
  ways_.resize(count);
  for (std::size_t n = 0; n < ROW * count; n += ROW) {
    const Vec own = load(&x[n]) - load(&before[n]) - way;
    ways_[n / ROW] = length(own);
    fastest = std::max(fastest, ways_[n / ROW]);
    if (!listed) continue;
    const Vec moved = load(&x[n]) - load(&listed_at_[n]) - off;
    farthest = std::max(farthest, dot(moved, moved));
  }
  travel_ = 2 * fastest;
  drift_ = 2 * std::sqrt(farthest);
  reach_ = layers_->thickness + std::min(travel_, FASTEST * layers_->thickness) +
           layers_->speed * h;
  return std::isfinite(dot(way, way));
}

void SelfContacts::list(const std::vector<double>& x) {
  const double d = layers_->thickness;
  listed_ = reach_ + std::clamp(STEPS_AHEAD * travel_, LEAST_MARGIN * d, MOST_MARGIN * d);
  listed_at_ = x;
  drift_ = 0;
  candidates_.clear();
  fill_grid(grid_, *layers_, x, listed_);
  std::size_t last = 0, begin = 0;
  const auto sort = [&] {
    std::sort(candidates_.begin() + static_cast<std::ptrdiff_t>(begin), candidates_.end(),
              [](const Candidate& a, const Candidate& b) { return a.particle < b.particle; });
    begin = candidates_.size();
  };
  visit_pairs(grid_, *layers_, x, listed_,
              [&](std::size_t t, std::int32_t n, const Triangle& triangle, Vec p) {
                const double least = layers_->least(t, n);
                if (!(least > 0)) return;
                const double place[3] = {p.x, p.y, p.z};
                const double apart = Box(triangle, 0).distance(place);
                if (!(apart <= listed_)) return;
                if (t != last) sort();
                last = t;
                // A little less, for what is lost in rounding.
                candidates_.push_back({n, static_cast<std::int32_t>(t), least,
                                       static_cast<float>(apart * (1 - 1e-6))});
              });
  sort();
}

void SelfContacts::find_hits(double h, const std::vector<double>& before, const std::vector<double>& x) {
  hits_.clear();
  flagged_.clear();
  const double look = reach_ + drift_;
  // Candidates of a triangle stand together.
  std::int32_t last = -1;
  Triangle triangle{Vec{}, Vec{}, Vec{}};
  Box box(triangle, 0);
  double carried = 0;
  for (const Candidate& one : candidates_) {
    if (one.gap > look) continue;
    if (one.triangle != last) {
      last = one.triangle;
      const std::int32_t* corners = layers_->corners(static_cast<std::size_t>(last));
      triangle = Triangle(corners, x.data());
      box = Box(triangle, 0);
      carried = std::max({way(corners[0]), way(corners[1]), way(corners[2])});
    }
    const double* place = &x[ROW * static_cast<std::size_t>(one.particle)];
    const double travel = way(one.particle) + carried;
    const double reach = std::min(reach_, one.least + travel + layers_->speed * h);
    if (!box.has(place, reach)) continue;
    const double apart = triangle.distance(load(place));
    if (!(apart < reach)) continue;
    Hit hit{one.particle, one.triangle, 0, apart, travel, one.least};
    hit.side = side_of(hit, before, x);
    hits_.push_back(hit);
    if (hit.side) flagged_.push_back({one.particle, one.triangle, hit.side});
  }
  std::stable_sort(flagged_.begin(), flagged_.end(), [](const Passage& a, const Passage& b) {
    return a.particle < b.particle;
  });
}

std::int32_t SelfContacts::side_of(const Hit& hit, const std::vector<double>& before,
                                   const std::vector<double>& x) const {
  const auto [particle, triangle] = std::pair(hit.particle, hit.triangle);
  const auto known = std::lower_bound(crossed_.begin(), crossed_.end(),
                                      Passage{particle, triangle, 0}, by_triangle);
  if (known != crossed_.end() && known->particle == particle && known->triangle == triangle)
    return known->side;
  if (hit.apart > hit.travel) return 0;
  const std::int32_t* corners = layers_->corners(static_cast<std::size_t>(triangle));
  return crossed_from(row_of(before, particle), row_of(x, particle),
                      Triangle(corners, before.data()), Triangle(corners, x.data()));
}

// Whether a particle is on the wrong side of another triangle that has a corner of this: the
// side that it is on of this one says nothing.
bool SelfContacts::came_round(const Hit& hit) const {
  const auto first = std::lower_bound(
      flagged_.begin(), flagged_.end(), hit.particle,
      [](const Passage& a, std::int32_t particle) { return a.particle < particle; });
  const std::int32_t* corners = layers_->corners(static_cast<std::size_t>(hit.triangle));
  for (auto one = first; one != flagged_.end() && one->particle == hit.particle; ++one) {
    const std::int32_t* others = layers_->corners(static_cast<std::size_t>(one->triangle));
    for (std::size_t k = 0; k < 3; ++k)
      if (has_corner(corners, others[k])) return true;
  }
  return false;
}

void SelfContacts::keep_apart(double h, std::vector<double>& before, std::vector<double>& x) {
  if (!layers_) return;
  hits_.clear();
  // Of what has blown up nothing is known any more.
  if (!measure(h, before, x)) return;
  if (reach_ + drift_ > listed_) list(x);
  find_hits(h, before, x);
  if (hits_.empty()) return;
  shifted_ = before;
  shifts_ = false;
  for (const Hit& hit : hits_)
    if (hit.side || flagged_.empty() || !came_round(hit)) part(hit, h, before, x);
  if (shifts_) before = shifted_;
}

void SelfContacts::part(const Hit& hit, double h, const std::vector<double>& before,
                        std::vector<double>& x) {
  const std::int32_t* corners = layers_->corners(static_cast<std::size_t>(hit.triangle));
  const Triangle now(corners, x.data());
  const Vec p = row_of(x, hit.particle);
  const Shares shares = now.shares(p);
  const Vec off = p - now.at(shares);
  double apart = length(off);
  const double height = hit.side ? hit.side * now.height(p) : apart;
  if (!(std::min(height, apart) < hit.least)) return;

  const bool through = height < 0;
  Vec out = off * (1 / apart);
  if (through || !(apart > 0)) out = direction(now.normal(), {0, 0, 1});
  if (through) out = out * hit.side, apart = height;
  const auto distance = [&](const std::vector<double>& rows) {
    const Triangle was(corners, rows.data());
    const Vec from = row_of(rows, hit.particle);
    return through ? hit.side * was.height(from) : was.distance(from);
  };
  const std::size_t who[4] = {
      ROW * static_cast<std::size_t>(hit.particle), ROW * static_cast<std::size_t>(corners[0]),
      ROW * static_cast<std::size_t>(corners[1]), ROW * static_cast<std::size_t>(corners[2])};
  const double share[4] = {1, -(1 - shares.b - shares.c), -shares.b, -shares.c};
  double weights[4], whole = 0;
  for (std::size_t k = 0; k < 4; ++k) {
    weights[k] = network_.inverse_masses[who[k] / ROW] * share[k];
    whole += weights[k] * share[k];
  }
  if (!(whole > 0)) return;

  const double first = distance(before);
  const double goal = std::min(hit.least, first + layers_->speed * h);
  const double begun = std::min(hit.least, shifts_ ? distance(shifted_) : first);
  const double pressed = std::max(0.0, begun - apart);
  const double back = std::max(0.0, goal - std::max(apart, begun));
  const Triangle was(corners, shifted_.data());
  Vec along = p - row_of(shifted_, hit.particle);
  const Vec ways[3] = {now.a - was.a, now.b - was.b, now.c - was.c};
  for (std::size_t k = 0; k < 3; ++k) along = along + ways[k] * share[k + 1];
  along = along - out * dot(along, out);
  const double slid = length(along), held = layers_->friction * pressed;
  const double stop = slid > held ? held / slid : 1;
  const Vec back_by = out * (back / whole);
  shifts_ = shifts_ || back > 0;
  const Vec by = out * (pressed / whole) - along * (stop / whole) + back_by;
  for (std::size_t k = 0; k < 4; ++k) {
    store(load(&x[who[k]]) + by * weights[k], &x[who[k]]);
    if (back > 0) store(load(&shifted_[who[k]]) + back_by * weights[k], &shifted_[who[k]]);
  }
}

void SelfContacts::look(const std::vector<double>& before, const std::vector<double>& x) {
  if (!layers_) return;
  std::vector<Passage> found;
  for (const Hit& hit : hits_) {
    if (!hit.side && hit.apart > 2 * hit.travel) continue;
    const std::int32_t* corners = layers_->corners(static_cast<std::size_t>(hit.triangle));
    const Triangle now(corners, x.data());
    const Vec p = row_of(x, hit.particle);
    std::int32_t side = hit.side;
    if (side) {
      if (!(side * now.height(p) < 0)) side = 0;
    } else {
      side = crossed_from(row_of(before, hit.particle), p, Triangle(corners, before.data()), now);
    }
    if (side) found.push_back({hit.particle, hit.triangle, side});
  }
  crossed_ = std::move(found);
}

Out<std::int64_t, 2> SelfContacts::ended() const {
  Buffer<std::int64_t> result(3 * crossed_.size());
  std::int64_t* to = result.get();
  for (const Passage& one : crossed_)
    for (const std::int32_t number : {one.particle, one.triangle, one.side}) *to++ = number;
  const std::size_t shape[2] = {crossed_.size(), 3};
  return result.release(shape);
}

std::int64_t SelfContacts::particles_passed() const {
  std::vector<std::int32_t> who;
  for (const Passage& one : crossed_) who.push_back(one.particle);
  std::sort(who.begin(), who.end());
  return std::unique(who.begin(), who.end()) - who.begin();
}

Out<double, 3> part_springs(const SpringNetwork& network, const SpringLayers& layers,
                            In<double, 2> before, In<double, 3> after, double h) {
  const std::size_t count = network.particles();
  if (before.shape(0) != count || before.shape(1) != 3 || after.shape(0) != 2 ||
      after.shape(1) != count || after.shape(2) != 3)
    throw std::invalid_argument("positions are (N, 3), and a state (2, N, 3)");
  std::vector<double> from(ROW * count), x(ROW * count);
  for (std::size_t n = 0; n < count; ++n) {
    std::copy_n(before.data() + 3 * n, 3, &from[ROW * n]);
    std::copy_n(after.data() + 3 * n, 3, &x[ROW * n]);
  }
  Buffer<double> result(6 * count);
  {
    nb::gil_scoped_release release;
    SelfContacts(layers, network).keep_apart(h, from, x);
    const double *places = after.data(), *speeds = places + 3 * count;
    for (std::size_t n = 0; n < count; ++n)
      for (std::size_t k = 0; k < 3; ++k) {
        const std::size_t row = ROW * n + k, at = 3 * n + k;
        // What friction and pressing took from the way, they take from the speed.
        const double taken = (x[row] - places[at]) - (from[row] - before.data()[at]);
        result.get()[at] = x[row];
        result.get()[3 * count + at] = speeds[at] + taken / h;
      }
  }
  const std::size_t shape[3] = {2, count, 3};
  return result.release(shape);
}

}  // namespace animtool
