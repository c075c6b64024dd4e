// The options of all stages of the library.
#pragma once

#include <filesystem>

#include "iris/core/options.h"
#include "iris/loop/alignment.h"
#include "iris/loop/bundle.h"
#include "iris/loop/options.h"
#include "iris/mapping/flog.h"
#include "iris/motion/scs.h"
#include "iris/render/dsnv.h"
#include "iris/session/session.h"
#include "iris/stereo/mwmf.h"
#include "iris/tour/camera_path.h"
#include "iris/views/selection.h"

namespace iris::pipeline {

struct Options {
  session::SessionOptions session;
  stereo::MwmfOptions stereo;
  motion::ScsOptions motion;
  views::ViewsOptions views;
  loop::LoopOptions loop;
  loop::BundleOptions bundle;
  loop::AlignmentOptions alignment;
  mapping::FlogOptions mapping;
  render::DsnvOptions render{.step = 2};  // the pictures of a tour pass by: half the time for 0.6 dB less
  tour::TourOptions tour;
  std::filesystem::path motion_pictures;  // folder for a picture of each frame's motion; empty = none. Not a declared
                                          // option: it changes no result

  void declare(OptionSet& set) {
    session.declare(set);
    stereo.declare(set);
    motion.declare(set);
    views.declare(set);
    loop.declare(set);
    bundle.declare(set);
    alignment.declare(set);
    mapping.declare(set);
    render.declare(set);
    tour.declare(set);
  }
};

}  // namespace iris::pipeline
