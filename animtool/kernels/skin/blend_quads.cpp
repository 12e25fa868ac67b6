// Linear blend skinning for processors with registers of four doubles; the build says
// where the compiler may use them, and the processor is asked before it runs.
#include "base/processor.h"
#include "skin/blend.h"

#if defined(__AVX2__) && defined(__GNUC__)
#define ANIMTOOL_QUADS
#include <cstring>
#endif

namespace animtool {

#ifdef ANIMTOOL_QUADS

namespace {

struct Quads {
  using Lanes = double __attribute__((vector_size(32)));

  static Lanes spread(double value) { return Lanes{value, value, value, value}; }
  static Lanes fetch(const double* from) {
    Lanes to;
    std::memcpy(&to, from, sizeof to);
    return to;
  }
  static Lanes gather(const double* const* rows, std::size_t at) {
    return Lanes{rows[0][at], rows[1][at], rows[2][at], rows[3][at]};
  }
};

}  // namespace

BlendFrames blend_in_quads(bool still) {
  if (!has_quads()) return nullptr;
  return still ? blend_frames<Quads, true> : blend_frames<Quads, false>;
}

#else

BlendFrames blend_in_quads(bool) { return nullptr; }

#endif

}  // namespace animtool
