// Linear blend skinning for processors with registers of four doubles.
#include "base/quads.h"
#include "skin/blend.h"

namespace animtool {

BlendFrames blend_in_quads() { return has_quads() ? blend_frames<Four<Quads>> : nullptr; }

}  // namespace animtool
