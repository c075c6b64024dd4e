// The example programs, run on a recording with a known path, and the example options files.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <cstdlib>
#include <opencv2/imgproc.hpp>
#include <sstream>

#include "export/products.h"
#include "iris/core/atomic_file.h"
#include "support/synthetic_session.h"
#include "support/temporary_folder.h"

namespace iris {
namespace {

namespace fs = std::filesystem;

constexpr int kFrames = 4;

class Examples : public ::testing::Test {
 protected:
  Examples() { iris::testing::write_synthetic_session(session_, kFrames); }

  // Exit code of an example; its output goes to the file "output".
  int run(const std::string& name, const std::string& arguments) const {
    const fs::path program = fs::path(IRIS_EXAMPLES) / ("example_" + name);
    const int status = std::system(
        (program.string() + " " + arguments + " > " + (folder_.path() / "output").string() + " 2>&1").c_str());
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  }
  std::string output() const { return read_file(folder_.path() / "output"); }

  iris::testing::TemporaryFolder folder_;
  fs::path session_ = folder_.path() / "session";
  fs::path picture_ = folder_.path() / "picture.png";
};

TEST_F(Examples, ShowTheDisparitiesOfAPair) {
  ASSERT_EQ(run("01_disparity", (session_ / "left/000000.png").string() + " " +
                                    (session_ / "right/000000.png").string() + " " + picture_.string()),
            0)
      << output();
  const cv::Mat picture = cv::imread(picture_.string());
  ASSERT_EQ(picture.size(), cv::Size(320, 240));
  cv::Scalar mean, deviation;
  cv::meanStdDev(picture, mean, deviation);
  EXPECT_GT(cv::norm(deviation), 10) << "all of one colour";
}

TEST_F(Examples, PrintTheCamerasPath) {
  ASSERT_EQ(run("02_camera_path", session_.string()), 0) << output();
  std::istringstream lines(output());
  int frames = 0;
  for (std::string line; std::getline(lines, line);) {
    if (line.starts_with("#")) continue;
    std::istringstream numbers(line);
    double stamp;
    Eigen::Vector3d t;
    ASSERT_TRUE(numbers >> stamp >> t.x() >> t.y() >> t.z()) << line;
    // Four motions of some millimetres' error each: disparities of 0.1 px at 2 m and 0.1 m baseline are 1.5 cm a
    // corner, and a hundred corners average.
    EXPECT_LT((t - iris::testing::synthetic_pose(frames).translation()).norm(), 0.01) << line;
    ++frames;
  }
  EXPECT_EQ(frames, kFrames);
}

TEST_F(Examples, DrawTheMapOfAView) {
  ASSERT_EQ(run("03_map_of_a_view", session_.string() + " 0 " + picture_.string()), 0) << output();
  const cv::Mat1b map = cv::imread(picture_.string(), cv::IMREAD_UNCHANGED);
  ASSERT_FALSE(map.empty());
  EXPECT_GT(cv::countNonZero(map == 0), 10);
  EXPECT_GT(cv::countNonZero(map == 255), 100);
  EXPECT_EQ(cv::countNonZero((map == 0) | (map == 205) | (map == 255)), static_cast<int>(map.total()));
}

TEST_F(Examples, RenderANovelView) {
  ASSERT_EQ(run("04_novel_view", session_.string() + " 0 0 " + picture_.string()), 0) << output();
  // From where the camera stood it is the recorded picture.
  const cv::Mat1b recorded = cv::imread((session_ / "left/000000.png").string(), cv::IMREAD_GRAYSCALE);
  const cv::Mat1b same = cv::imread(picture_.string(), cv::IMREAD_GRAYSCALE);
  ASSERT_EQ(same.size(), recorded.size());
  EXPECT_LT(cv::countNonZero(cv::abs(same - recorded) > 8), 0.1 * static_cast<double>(same.total()));
  ASSERT_EQ(run("04_novel_view", session_.string() + " 0 0.1 " + picture_.string()), 0) << output();
  const cv::Mat1b moved = cv::imread(picture_.string(), cv::IMREAD_GRAYSCALE);
  EXPECT_GT(cv::countNonZero(cv::abs(moved - recorded) > 8), 0.3 * static_cast<double>(same.total()));
}

TEST_F(Examples, SayHowTheyAreUsed) {
  for (const char* name : {"01_disparity", "02_camera_path", "03_map_of_a_view", "04_novel_view"}) {
    EXPECT_EQ(run(name, ""), 2);
    EXPECT_THAT(output(), ::testing::HasSubstr("usage: ")) << name;
  }
  EXPECT_EQ(run("02_camera_path", (folder_.path() / "nothing").string()), 3);
  EXPECT_THAT(output(), ::testing::HasSubstr("nothing"));
}

TEST(ExampleOptions, AreOptionsOfARun) {
  int files = 0;
  for (const auto& entry : fs::directory_iterator(fs::path(IRIS_SOURCE_DIR) / "examples")) {
    if (entry.path().extension() != ".toml") continue;
    exporters::RunOptions options;
    OptionSet set;
    options.declare(set);
    EXPECT_NO_THROW(set.read_toml(entry.path())) << entry.path();
    EXPECT_NO_THROW(set.validate()) << entry.path();
    ++files;
  }
  EXPECT_GE(files, 2);
}

}  // namespace
}  // namespace iris
