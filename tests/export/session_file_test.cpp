#include "export/session_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <map>
#include <opencv2/imgcodecs.hpp>
#include <sstream>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/rectify/rectifier.h"
#include "iris/session/session.h"
#include "iris/simulate/simulator.h"
#include "support/temporary_folder.h"

namespace iris::exporters {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::ThrowsMessage;

simulate::SimulateOptions small_options() {
  simulate::SimulateOptions options;
  options.frames = 3;
  options.width = 160;
  options.height = 120;
  options.colour = true;
  return options;
}

std::map<std::string, std::string> files_of(const fs::path& folder) {
  std::map<std::string, std::string> files;
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    if (entry.is_regular_file()) files[fs::relative(entry.path(), folder).string()] = read_file(entry.path());
  }
  return files;
}

class SessionFile : public ::testing::Test {
 protected:
  void write(const fs::path& folder, const simulate::SimulateOptions& options = small_options(),
             const std::atomic<bool>* stop = nullptr) const {
    OptionSet set;
    simulate::SimulateOptions copy = options;
    copy.declare(set);
    write_session(folder, scene_, options, {}, set.to_toml(), {.stop = stop});
  }
  testing::TemporaryFolder temporary_;
  simulate::Scene scene_ = simulate::make_scene("boxes", 1);
};

TEST_F(SessionFile, IsReadAsARecordingWithTheRigAndTheImagesOfTheSimulator) {
  const fs::path folder = temporary_.path() / "session";
  write(folder);
  const simulate::SimulateOptions options = small_options();
  const simulate::Simulator simulator(scene_, simulate::make_path(scene_, options), options);
  const auto session = session::open_session(folder, {});
  EXPECT_EQ(session->kind(), "EuRoC/ASL");
  ASSERT_EQ(session->size(), 3);
  EXPECT_TRUE(session->notes().empty());
  const StereoCalibration &written = simulator.calibration(), &read = session->calibration();
  EXPECT_EQ(read.left.K, written.left.K);
  EXPECT_EQ(read.right.K, written.right.K);
  EXPECT_EQ(read.left.coefficients, written.left.coefficients);
  EXPECT_EQ(read.right.coefficients, written.right.coefficients);
  EXPECT_LT((read.right_from_left.matrix() - written.right_from_left.matrix()).norm(), 1e-12);
  for (int i = 0; i < 3; ++i) {
    const StereoFrame expected = simulator.frame(i), frame = session->read(i);
    EXPECT_EQ(session->stamp_ns(i), simulator.stamp_ns(i));
    EXPECT_EQ(cv::norm(frame.left, expected.left, cv::NORM_INF), 0);
    EXPECT_EQ(cv::norm(frame.right, expected.right, cv::NORM_INF), 0);
  }
}

TEST_F(SessionFile, HoldsTheTruthOfEachFrame) {
  const fs::path folder = temporary_.path() / "session";
  write(folder);
  const simulate::SimulateOptions options = small_options();
  const simulate::Simulator simulator(scene_, simulate::make_path(scene_, options), options);
  std::ifstream trajectory(folder / "truth/trajectory.tum");
  for (int i = 0; i < 3; ++i) {
    std::string line;
    ASSERT_TRUE(std::getline(trajectory, line));
    std::istringstream numbers(line);
    double t, x, y, z;
    numbers >> t >> x >> y >> z;
    EXPECT_NEAR(t, static_cast<double>(simulator.stamp_ns(i)) * 1e-9, 1e-6);
    EXPECT_LT((Eigen::Vector3d(x, y, z) - simulator.world_from_left(i).translation()).norm(), 1e-9);

    const simulate::FrameTruth truth = simulator.truth(i);
    const std::string name = "00000" + std::to_string(i) + ".png";
    const cv::Mat code = cv::imread((folder / "truth/disparity" / name).string(), cv::IMREAD_UNCHANGED);
    ASSERT_EQ(code.type(), CV_16UC1);
    cv::Mat1f disparity;
    code.convertTo(disparity, CV_32F, 1.0 / 256);
    EXPECT_LE(cv::norm(disparity, truth.disparity, cv::NORM_INF), 0.5 / 256 + 1e-6);
    for (const auto& [what, mask] :
         {std::pair("occlusion", truth.occluded), std::pair("discontinuity", truth.discontinuity),
          std::pair("textured", truth.textured)}) {
      const cv::Mat image = cv::imread((folder / "truth" / what / name).string(), cv::IMREAD_UNCHANGED);
      ASSERT_EQ(image.type(), CV_8UC1) << what;
      EXPECT_EQ(cv::norm(image, mask, cv::NORM_INF), 0) << what;
    }
  }
  for (const char* file : {"plan.png", "plan.yaml", "plan_0.png", "plan_2.yaml", "scene.glb"}) {
    EXPECT_TRUE(fs::exists(folder / "truth" / file)) << file;
  }
}

TEST_F(SessionFile, GoesOnWhereItWasInterruptedAndGivesTheSameBytes) {
  const fs::path whole = temporary_.path() / "whole", cut = temporary_.path() / "cut";
  with_threads(1, [&] { write(whole); });
  const std::atomic<bool> stop = true;
  EXPECT_THROW(write(cut, small_options(), &stop), Interrupted);
  EXPECT_FALSE(fs::exists(cut / "mav0/cam0/data.csv"));
  with_threads(3, [&] { write(cut); });
  EXPECT_EQ(files_of(cut), files_of(whole));
  const auto files = files_of(whole);
  size_t i = 0;
  for (const auto& [name, bytes] : files) {
    if (i++ % 3 == 0 && name != "truth/options.toml") fs::remove(whole / name);
  }
  write(whole);
  EXPECT_EQ(files_of(whole), files);
}

TEST_F(SessionFile, RefusesAFolderThatHoldsSomethingElse) {
  const fs::path folder = temporary_.path() / "session";
  write(folder);
  simulate::SimulateOptions other = small_options();
  other.seed = 2;
  EXPECT_THAT([&] { write(folder, other); }, ThrowsMessage<InputError>(HasSubstr("other options")));
  write_file(temporary_.path() / "mine/notes.txt", std::string_view("keep me"));
  EXPECT_THAT([&] { write(temporary_.path() / "mine"); },
              ThrowsMessage<InputError>(HasSubstr("is no simulated session")));
}

// What would fill the memory at the end of the work is refused before it.
TEST_F(SessionFile, RefusesATrueMapOfTooManyCells) {
  simulate::SimulateOptions options = small_options();
  const fs::path folder = temporary_.path() / "session";
  EXPECT_THAT([&] { write_session(folder, scene_, options, {.cell = 1e-5}, "", {}); },
              ThrowsMessage<UsageError>(HasSubstr("--mapping.cell")));
  EXPECT_FALSE(fs::exists(folder));
}

}  // namespace
}  // namespace iris::exporters
