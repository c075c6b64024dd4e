// iris calibrate and iris rectify --check as their users call them.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <opencv2/core.hpp>

#include "iris/calibrate/calibration_file.h"
#include "iris/core/atomic_file.h"
#include "iris/session/image_file.h"
#include "iris/workspace/view_files.h"
#include "support/program.h"
#include "support/target_images.h"
#include "support/temporary_folder.h"
#include "support/test_data.h"

namespace iris {
namespace {

namespace fs = std::filesystem;
using iris::testing::run_program;
using iris::testing::TemporaryFolder;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

class CalibrateCli : public ::testing::Test {
 protected:
  static constexpr int kPairs = 7;
  static constexpr const char* kTarget = "squares:7x5:20mm";

  // Seven pairs of the thesis's target in left/ and right/, one more that shows the same again, and one without target.
  static void SetUpTestSuite() {
    folder_ = new TemporaryFolder;
    const calibrate::Target target = calibrate::parse_target(kTarget);
    const StereoCalibration rig = iris::testing::target_rig();
    const iris::testing::TargetRenderer left(rig.left), right(rig.right);
    const iris::testing::Sheet sheet(target);
    std::vector<Pose> poses = iris::testing::target_poses(target, rig, kPairs, 31);
    poses.push_back(poses[2]);
    for (size_t i = 0; i <= poses.size(); ++i) {
      const auto seed = static_cast<unsigned>(2 * i);
      const bool seen = i < poses.size();
      const cv::Mat empty = cv::Mat1b(480, 640, uchar{120});
      write(images() / "left" / fmt::format("{:02}.png", i), seen ? left.render(sheet, poses[i], 45, seed) : empty);
      write(images() / "right" / fmt::format("{:02}.png", i),
            seen ? right.render(sheet, rig.right_from_left * poses[i], 45, seed + 1) : empty);
    }
  }
  static void TearDownTestSuite() {
    delete folder_;
    folder_ = nullptr;
  }
  static void write(const fs::path& path, const cv::Mat& image) { write_file(path, workspace::encode_png(image)); }
  static fs::path images() { return folder_->path() / "images"; }
  static iris::testing::ProgramResult calibrate(const fs::path& from, const std::string& out, const std::string& target,
                                                std::vector<std::string> more = {}) {
    std::vector<std::string> arguments = {"calibrate", from.string(), "-o", (folder_->path() / out).string(),
                                          "--target",  target};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return run_program(arguments);
  }

  static TemporaryFolder* folder_;
};
TemporaryFolder* CalibrateCli::folder_ = nullptr;

TEST_F(CalibrateCli, WritesACalibrationAndItsReport) {
  const fs::path report = folder_->path() / "report.html";
  const auto result = calibrate(images(), "calibration.yaml", kTarget, {"--report", report.string()});
  ASSERT_EQ(result.exit_code, 0) << result.output;
  EXPECT_THAT(result.output,
              AllOf(HasSubstr("7 of 9 pairs of images are used (1 without target, 0 blurred, 1 that show "
                              "nothing new)"),
                    HasSubstr("rows of unseen pairs")));
  const StereoCalibration truth = iris::testing::target_rig();
  const StereoCalibration found = calibrate::read_calibration(folder_->path() / "calibration.yaml");
  EXPECT_EQ(found.left.width, 640);
  EXPECT_NEAR(found.right_centre_in_left().norm(), truth.right_centre_in_left().norm(), 1e-4);
  EXPECT_NEAR(found.left.K(0, 0), truth.left.K(0, 0), 1);
  const std::string html = read_file(report);
  EXPECT_THAT(html, AllOf(HasSubstr("Stereo calibration"), HasSubstr("rows of unseen pairs"), HasSubstr("left fx"),
                          HasSubstr("data:image/svg+xml;base64,"), HasSubstr("10 m"), HasSubstr("<td>06.png</td>"),
                          HasSubstr("RMS before that: each camera calibrated alone"), Not(HasSubstr("<td>images")),
                          Not(HasSubstr("http:")), Not(HasSubstr("https:"))));
  EXPECT_THAT(html, AllOf(Not(HasSubstr("nan px")), Not(HasSubstr("nan mm")), Not(HasSubstr("nan cm"))));
  // Threads do not change it.
  ASSERT_EQ(calibrate(images(), "one.yaml", kTarget, {"--threads", "1", "--quiet"}).exit_code, 0);
  EXPECT_EQ(read_file(folder_->path() / "one.yaml"), read_file(folder_->path() / "calibration.yaml"));
}

// Pairs of a target have neither a calibration nor times: what there is can be looked at all the same, and nothing is
// made up.
TEST_F(CalibrateCli, ImagesWithoutCalibrationAndTimesCanBeLookedAtAndRectified) {
  const auto info = run_program({"info", images().string()});
  EXPECT_EQ(info.exit_code, 0) << info.output;
  EXPECT_THAT(info.output, AllOf(HasSubstr("frames       9"), HasSubstr("640 x 480"), HasSubstr("no time stamps"),
                                 HasSubstr("calibration  none"), HasSubstr("iris calibrate")));
  const fs::path calibration = folder_->path() / "of_images.yaml", rectified = folder_->path() / "rectified_images";
  ASSERT_EQ(calibrate(images(), "of_images.yaml", kTarget).exit_code, 0);
  ASSERT_EQ(run_program(
                {"rectify", images().string(), "-o", rectified.string(), "--session.calibration", calibration.string()})
                .exit_code,
            0);
  EXPECT_FALSE(fs::exists(rectified / "times.txt"));
  const auto again = run_program({"info", rectified.string()});
  EXPECT_THAT(again.output, AllOf(HasSubstr("duration     unknown"), HasSubstr("recorded rectified")));
  // One that was asked for and cannot be used is an error.
  EXPECT_EQ(run_program({"info", images().string(), "--session.calibration", "missing.yaml"}).exit_code, 3);
}

TEST_F(CalibrateCli, EveryFormatAndFilesByName) {
  std::vector<std::string> arguments = {"calibrate"};
  for (const char* side : {"left", "right"}) {
    for (int i = 0; i < kPairs; ++i) arguments.push_back((images() / side / fmt::format("{:02}.png", i)).string());
  }
  for (const char* name : {"camchain.yaml", "camera_info.yaml", "rig"}) {
    std::vector<std::string> all = arguments;
    all.insert(all.end(), {"-o", (folder_->path() / name).string(), "--target", kTarget, "--quiet"});
    const auto result = run_program(all);
    ASSERT_EQ(result.exit_code, 0) << result.output;
  }
  const double truth = iris::testing::target_rig().right_centre_in_left().norm();
  for (const char* name : {"camchain.yaml", "camera_info_left.yaml", "rig"}) {
    EXPECT_NEAR(calibrate::read_calibration(folder_->path() / name).right_centre_in_left().norm(), truth, 1e-4) << name;
  }
}

// A text in place of an image, an empty file, a cut one: the pair is skipped by name, in folders as in lists of files.
TEST_F(CalibrateCli, SkipsPairsWithDamagedImages) {
  const fs::path damaged = folder_->path() / "damaged";
  fs::create_directories(damaged);
  fs::copy(images(), damaged, fs::copy_options::recursive);
  write_file(damaged / "left" / "00.png", "not an image\n");
  write_file(damaged / "right" / "04.png", "");
  const auto skips = AllOf(HasSubstr("a pair is skipped: " + (damaged / "left" / "00.png").string() + ": "),
                           HasSubstr("a pair is skipped: " + (damaged / "right" / "04.png").string() + ": "),
                           HasSubstr("5 of 9 pairs of images are used (2 damaged, 1 without target, 0 blurred"));
  const auto folder = calibrate(damaged, "from_folder.yaml", kTarget);
  EXPECT_EQ(folder.exit_code, 0) << folder.output;
  EXPECT_THAT(folder.output, skips);
  std::vector<std::string> others;
  for (const char* side : {"left", "right"}) {
    for (int i = 0; i < kPairs + 2; ++i) others.push_back((damaged / side / fmt::format("{:02}.png", i)).string());
  }
  const std::string first = others.front();
  others.erase(others.begin());
  const auto files = calibrate(first, "from_files.yaml", kTarget, others);
  EXPECT_EQ(files.exit_code, 0) << files.output;
  EXPECT_THAT(files.output, skips);
  const StereoCalibration a = calibrate::read_calibration(folder_->path() / "from_folder.yaml"),
                          b = calibrate::read_calibration(folder_->path() / "from_files.yaml");
  EXPECT_EQ(a.left.K, b.left.K);
  EXPECT_EQ(a.right_from_left.matrix(), b.right_from_left.matrix());
  // Too few remain, and none.
  for (int i = 1; i < kPairs; ++i) {
    const std::string text =
        i < 5 ? std::string(read_file(damaged / "left" / fmt::format("{:02}.png", i))).substr(0, 999) : std::string();
    write_file(damaged / "left" / fmt::format("{:02}.png", i), text);
  }
  const auto few = calibrate(damaged, "few.yaml", kTarget);
  EXPECT_EQ(few.exit_code, 3) << few.output;
  EXPECT_THAT(few.output, AllOf(HasSubstr("take more images"), HasSubstr("7 pairs cannot be read")));
  const auto none = calibrate(first, "none.yaml", kTarget, {(damaged / "right" / "00.png").string()});
  EXPECT_EQ(none.exit_code, 3) << none.output;
  EXPECT_THAT(none.output, AllOf(HasSubstr(first), HasSubstr("no pair can be read")));
}

TEST_F(CalibrateCli, ErrorsNameTheCauseAndTheRemedy) {
  const auto expect = [&](const iris::testing::ProgramResult& result, int code, const auto& matcher) {
    EXPECT_EQ(result.exit_code, code) << result.output;
    EXPECT_THAT(result.output, matcher);
  };
  expect(calibrate(images(), "x.yaml", "squares:7x4:20mm"), 3,
         AllOf(HasSubstr("sees the target in 0"), HasSubstr("a grid of 7 x 5 squares (in 16 images)")));
  expect(calibrate(images(), "x.yaml", "circles:7x4:20mm"), 2, HasSubstr("no kind of target"));
  expect(calibrate(images(), "x.txt", kTarget), 2, HasSubstr(".yaml"));
  expect(calibrate(images(), "x.yaml", "charuco:7x4:20mm:10mm:9X9"), 2, HasSubstr("4X4_50"));
  expect(calibrate(folder_->path() / "nothing", "x.yaml", kTarget), 3, HasSubstr("no such recording"));
  expect(calibrate(images(), "camchain.yaml", kTarget, {"--calibrate.distortion", "radtan"}), 2, HasSubstr("radtan4"));
  // Left and right swapped.
  const fs::path swapped = folder_->path() / "swapped";
  fs::create_directories(swapped);
  fs::copy(images() / "left", swapped / "right");
  fs::copy(images() / "right", swapped / "left");
  expect(calibrate(swapped, "x.yaml", kTarget), 3, AllOf(HasSubstr("98 mm left of"), HasSubstr("swapped")));
  // Mirrored images of one camera.
  const fs::path mirrored = folder_->path() / "mirrored";
  fs::create_directories(mirrored);
  fs::copy(images() / "left", mirrored / "left");
  for (const auto& entry : fs::directory_iterator(images() / "right")) {
    cv::Mat image = session::read_image(entry.path());
    cv::flip(image, image, 1);
    write(mirrored / "right" / entry.path().filename(), image);
  }
  expect(calibrate(mirrored, "x.yaml", kTarget), 3, HasSubstr("mirrored"));
  // One camera sees too little.
  const fs::path few = folder_->path() / "few";
  fs::create_directories(few);
  fs::copy(images() / "left", few / "left");
  for (int i = 0; i < 9; ++i) {
    const std::string name = fmt::format("{:02}.png", i);
    write(few / "right" / name,
          i < 2 ? session::read_image(images() / "right" / name) : cv::Mat(cv::Mat1b(480, 640, uchar{90})));
  }
  expect(calibrate(few, "x.yaml", kTarget), 3,
         AllOf(HasSubstr("the right camera sees the target in 2"), HasSubstr("take more images")));
  // Two resolutions: within a recording, and of two recordings.
  const fs::path sizes = folder_->path() / "sizes";
  fs::create_directories(sizes);
  fs::copy(images(), sizes, fs::copy_options::recursive);
  write(sizes / "left" / "04.png", cv::Mat1b(240, 320, uchar{90}));
  expect(calibrate(sizes, "x.yaml", kTarget), 3,
         AllOf(HasSubstr("04.png"), HasSubstr("320x240"), HasSubstr("640x480")));
  const fs::path other = folder_->path() / "other";
  for (const char* side : {"left", "right"}) {
    for (int i = 0; i < 3; ++i) write(other / side / fmt::format("{:02}.png", i), cv::Mat1b(240, 320, uchar{90}));
  }
  expect(calibrate(images(), "x.yaml", kTarget, {other.string()}), 3,
         AllOf(HasSubstr("320x240"), HasSubstr("one resolution")));
  EXPECT_FALSE(fs::exists(folder_->path() / "x.yaml"));
}

TEST_F(CalibrateCli, CheckingAndWritingImagesExcludeEachOther) {
  const fs::path out = folder_->path() / "rectified";
  const auto result = run_program({"rectify", images().string(), "--check", "-o", out.string()});
  EXPECT_EQ(result.exit_code, 2) << result.output;
  EXPECT_THAT(result.output, HasSubstr("--check writes no images: leave out -o"));
  EXPECT_FALSE(fs::exists(out));
}

// The rover's right image lies 3 px low; its calibration says so. Without that the check finds it, the refinement
// removes it, and the refined file passes the check.
TEST_F(CalibrateCli, CheckFindsTheRoversThreePixelsAndRefineRemovesThem) {
  IRIS_NEEDS_TEST_DATA("rover_sandbox_b");
  const std::string rover = iris::testing::test_data("rover_sandbox_b").string();
  std::string text = read_file(fs::path(rover) / "calibration.yaml");
  text.replace(text.find("144."), 4, "141.");
  const std::string wrong = (folder_->path() / "wrong.yaml").string(),
                    refined = (folder_->path() / "refined.yaml").string();
  write_file(wrong, text);
  const auto check = [&](std::vector<std::string> more) {
    more.insert(more.begin(), {"rectify", rover, "--check", "--quiet", "--rectify.frames", "12"});
    return run_program(more);
  };
  EXPECT_EQ(check({}).exit_code, 0);
  const auto found = check({"--session.calibration", wrong});
  EXPECT_EQ(found.exit_code, 4) << found.output;
  EXPECT_THAT(found.output, AllOf(HasSubstr("does not fit"), HasSubstr("row +3.")));
  const auto refining = check({"--session.calibration", wrong, "--refine", refined});
  EXPECT_EQ(refining.exit_code, 0) << refining.output;
  EXPECT_THAT(refining.output, HasSubstr("right camera turned by"));
  const auto again = check({"--session.calibration", refined});
  EXPECT_EQ(again.exit_code, 0) << again.output;
  EXPECT_THAT(again.output, HasSubstr("fits this recording"));
  // Whatever files the format has, the command that is printed names one that can be read.
  for (const char* format : {"ros", "euroc", "kalibr"}) {
    const std::string name = (folder_->path() / fmt::format("refined_{}.yaml", format)).string();
    const auto other = check({"--session.calibration", wrong, "--refine", name, "--format", format});
    ASSERT_EQ(other.exit_code, 0) << other.output;
    const std::string before = "--session.calibration ";
    const size_t begin = other.output.rfind(before) + before.size();
    const std::string named = other.output.substr(begin, other.output.find(' ', begin) - begin);
    EXPECT_THAT(other.output, HasSubstr("written: " + named + "\n"));
    EXPECT_NEAR(calibrate::read_calibration(named).right.K(1, 2), 141, 1e-9) << named;
  }
  EXPECT_EQ(run_program({"rectify", rover}).exit_code, 2);
  EXPECT_EQ(run_program({"rectify", rover, "-o", (folder_->path() / "r").string(), "--refine", refined}).exit_code, 2);
}

}  // namespace
}  // namespace iris
