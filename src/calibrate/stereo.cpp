#include "iris/calibrate/stereo.h"

#include <ceres/ceres.h>
#include <ceres/rotation.h>
#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <numbers>
#include <opencv2/calib3d.hpp>

#include "iris/core/error.h"
#include "iris/core/median.h"

namespace iris::calibrate {
namespace {

using Vec = Eigen::Vector2d;
using Status = StereoCalibrationResult::Status;

constexpr int kIntrinsics = 12;  // fx fy cx cy and up to eight coefficients
constexpr int kLeastViews = 3;
constexpr double kDegrees = 180 / std::numbers::pi;

struct Lens {
  Distortion distortion = Distortion::radial_tangential;
  int coefficients = 5;
  int zhang_flags = 0;  // of cv::calibrateCamera
};

Lens lens_of(const std::string& name) {
  constexpr int kRadial = cv::CALIB_ZERO_TANGENT_DIST | cv::CALIB_FIX_K3;
  if (name == "radial") return {Distortion::radial_tangential, 2, kRadial};
  if (name == "radtan4") return {Distortion::radial_tangential, 4, cv::CALIB_FIX_K3};
  if (name == "rational") return {Distortion::radial_tangential, 8, cv::CALIB_FIX_K3};  // the rest from there
  if (name == "fisheye") return {Distortion::equidistant, 4, 0};
  return {Distortion::radial_tangential, 5, 0};
}

// --- parameters ----------------------------------------------------------------------------------------------------

using Intrinsics = std::array<double, kIntrinsics>;
using Transform = std::array<double, 6>;  // rotation vector, translation

Intrinsics intrinsics_of(const CameraModel& camera) {
  Intrinsics values{camera.K(0, 0), camera.K(1, 1), camera.K(0, 2), camera.K(1, 2)};
  std::copy(camera.coefficients.begin(), camera.coefficients.end(), values.begin() + 4);
  return values;
}

void set_intrinsics(CameraModel& camera, const double* values) {
  camera.K << values[0], 0, values[2], 0, values[1], values[3], 0, 0, 1;
  std::copy_n(values + 4, camera.coefficients.size(), camera.coefficients.begin());
}

Transform transform_of(const Pose& pose) {
  const Eigen::AngleAxisd turn(pose.linear());
  Transform values{};
  Eigen::Map<Eigen::Vector3d>(values.data()) = turn.angle() * turn.axis();
  Eigen::Map<Eigen::Vector3d>(values.data() + 3) = pose.translation();
  return values;
}

Pose pose_of(const double* values) {
  const Eigen::Map<const Eigen::Vector3d> turn(values);
  Pose pose = Pose::Identity();
  if (turn.norm() > 0) pose.linear() = Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix();
  pose.translation() = Eigen::Map<const Eigen::Vector3d>(values + 3);
  return pose;
}

// --- residuals of (2.8) --------------------------------------------------------------------------------------------

// The same projection as CameraModel::project, for automatic derivatives.
template <bool kFisheye, class T>
void project(const T* c, const T* p, T* pixel) {
  using std::atan2;
  using std::sqrt;
  T x = p[0] / p[2], y = p[1] / p[2];
  const T r2 = x * x + y * y;
  if constexpr (kFisheye) {
    if (r2 > T(1e-16)) {
      const T r = sqrt(p[0] * p[0] + p[1] * p[1]), theta = atan2(r, p[2]), t2 = theta * theta;
      const T s = theta * (T(1) + t2 * (c[4] + t2 * (c[5] + t2 * (c[6] + t2 * c[7])))) / r;
      x = p[0] * s;
      y = p[1] * s;
    }
  } else {
    const T radial = (T(1) + r2 * (c[4] + r2 * (c[5] + r2 * c[8]))) / (T(1) + r2 * (c[9] + r2 * (c[10] + r2 * c[11])));
    const T xd = x * radial + T(2) * c[6] * x * y + c[7] * (r2 + T(2) * x * x);
    const T yd = y * radial + c[6] * (r2 + T(2) * y * y) + T(2) * c[7] * x * y;
    x = xd;
    y = yd;
  }
  pixel[0] = c[0] * x + c[2];
  pixel[1] = c[1] * y + c[3];
}

template <class T>
void transform(const T* t, const T* p, T* q) {
  ceres::AngleAxisRotatePoint(t, p, q);
  for (int i = 0; i < 3; ++i) q[i] += t[3 + i];
}

template <bool kFisheye>
struct LeftResidual {
  Vec seen;
  template <class T>
  bool operator()(const T* camera, const T* left_from_grid, const T* corner, T* residual) const {
    T q[3];
    transform(left_from_grid, corner, q);
    if (!(q[2] > T(1e-9))) return false;
    T pixel[2];
    project<kFisheye>(camera, q, pixel);
    residual[0] = T(seen.x()) - pixel[0];
    residual[1] = T(seen.y()) - pixel[1];
    return true;
  }
};

template <bool kFisheye>
struct RightResidual {
  Vec seen;
  template <class T>
  bool operator()(const T* camera, const T* right_from_left, const T* left_from_grid, const T* corner,
                  T* residual) const {
    T q[3], s[3];
    transform(left_from_grid, corner, q);
    transform(right_from_left, q, s);
    if (!(s[2] > T(1e-9))) return false;
    T pixel[2];
    project<kFisheye>(camera, s, pixel);
    residual[0] = T(seen.x()) - pixel[0];
    residual[1] = T(seen.y()) - pixel[1];
    return true;
  }
};

// What is known of a corner's place on the sheet before: where it should be. In pixels, like the errors of the images.
struct SheetResidual {
  Eigen::Vector3d corner;
  const double* weight;  // [px/m]
  template <class T>
  bool operator()(const T* place, T* residual) const {
    for (int i = 0; i < 3; ++i) residual[i] = *weight * (place[i] - corner(i));
    return true;
  }
};

// --- each camera alone ---------------------------------------------------------------------------------------------

struct SingleCamera {
  CameraModel model;
  std::vector<Pose> cam_from_grid;  // of the views that this camera sees, in order
};

Pose pose_from_cv(const cv::Mat& rotation, const cv::Mat& translation) {
  cv::Mat1d r, t;
  rotation.reshape(1, 3).convertTo(r, CV_64F);
  translation.reshape(1, 3).convertTo(t, CV_64F);
  const double values[6] = {r(0), r(1), r(2), t(0), t(1), t(2)};
  return pose_of(values);
}

double rms_of_single(const SingleCamera& camera, const std::vector<const Corners*>& seen,
                     const std::vector<Eigen::Vector3d>& sheet) {
  double sum = 0;
  size_t count = 0;
  for (size_t v = 0; v < seen.size(); ++v) {
    for (size_t i = 0; i < seen[v]->size(); ++i) {
      const Eigen::Vector3d& p = sheet[static_cast<size_t>(seen[v]->ids[i])];
      sum += (camera.model.project(camera.cam_from_grid[v] * p) - seen[v]->points[i]).squaredNorm();
      ++count;
    }
  }
  return std::sqrt(sum / static_cast<double>(count));
}

// Coefficients of the equidistant lens that bends rays like a radial one (k1, k2 in D), up to 1 rad or the image's
// corner: least squares over the angle.
std::vector<double> equidistant_like(const Eigen::Matrix3d& K, const cv::Mat1d& D, int width, int height) {
  const cv::Mat1d d = D.reshape(1, 1);
  const double end = std::min(1.0, std::hypot(width / 2.0, height / 2.0) / K(0, 0));
  constexpr int kSamples = 50;
  Eigen::Matrix<double, kSamples, 2> A;
  Eigen::Matrix<double, kSamples, 1> b;
  for (int i = 0; i < kSamples; ++i) {
    const double theta = end * (i + 1) / kSamples, r = std::tan(theta), r2 = r * r;
    A.row(i) << std::pow(theta, 3), std::pow(theta, 5);
    b(i) = r * (1 + r2 * (d(0) + r2 * d(1))) - theta;
  }
  const Eigen::Vector2d k = (A.transpose() * A).ldlt().solve(A.transpose() * b);
  return {k(0), k(1), 0, 0};
}

// Zhang's method.
SingleCamera calibrate_single(const std::vector<const Corners*>& seen, const std::vector<Eigen::Vector3d>& sheet,
                              const Lens& lens, int width, int height) {
  std::vector<std::vector<cv::Point3f>> objects;
  std::vector<std::vector<cv::Point2f>> images;
  for (const Corners* corners : seen) {
    objects.emplace_back();
    images.emplace_back();
    for (size_t i = 0; i < corners->size(); ++i) {
      const Eigen::Vector3d& p = sheet[static_cast<size_t>(corners->ids[i])];
      objects.back().emplace_back(static_cast<float>(p.x()), static_cast<float>(p.y()), 0.0f);
      images.back().emplace_back(static_cast<float>(corners->points[i].x()),
                                 static_cast<float>(corners->points[i].y()));
    }
  }
  SingleCamera camera;
  camera.model.width = width;
  camera.model.height = height;
  camera.model.distortion = lens.distortion;
  camera.model.coefficients.assign(static_cast<size_t>(lens.coefficients), 0.0);
  cv::Mat1d K, D;
  std::vector<cv::Mat> rotations, translations;
  const cv::Size size(width, height);
  const cv::TermCriteria until(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 100, 1e-9);
  const auto take = [&](SingleCamera& taken) {
    taken.model.K << K(0, 0), 0, K(0, 2), 0, K(1, 1), K(1, 2), 0, 0, 1;
    const cv::Mat1d d = D.reshape(1, 1);
    for (int i = 0; i < std::min(lens.coefficients, d.cols); ++i) {
      taken.model.coefficients[static_cast<size_t>(i)] = d(i);
    }
    taken.cam_from_grid.clear();
    for (size_t i = 0; i < rotations.size(); ++i) {
      taken.cam_from_grid.push_back(pose_from_cv(rotations[i], translations[i]));
    }
  };
  if (lens.distortion != Distortion::equidistant) {
    cv::calibrateCamera(objects, images, size, K, D, rotations, translations, lens.zhang_flags, until);
    take(camera);
    return camera;
  }
  // Fisheye: OpenCV's own method goes astray with narrow lenses, one by way of a radial lens with wide ones. The better
  // of both starts.
  SingleCamera by_radial = camera;
  double best = std::numeric_limits<double>::infinity();
  cv::calibrateCamera(objects, images, size, K, D, rotations, translations,
                      cv::CALIB_ZERO_TANGENT_DIST | cv::CALIB_FIX_K3, until);
  take(by_radial);
  by_radial.model.coefficients = equidistant_like(by_radial.model.K, D, width, height);
  const double radial_rms = rms_of_single(by_radial, seen, sheet);
  if (std::isfinite(radial_rms)) {
    best = radial_rms;
    camera = by_radial;
  }
  try {
    SingleCamera by_fisheye = by_radial;
    cv::fisheye::calibrate(objects, images, size, K, D, rotations, translations,
                           cv::fisheye::CALIB_RECOMPUTE_EXTRINSIC | cv::fisheye::CALIB_FIX_SKEW, until);
    take(by_fisheye);
    if (rms_of_single(by_fisheye, seen, sheet) < best) camera = by_fisheye;
  } catch (const cv::Exception&) {  // it gives up on some images; then the other way is left
    if (!std::isfinite(best)) throw;
  }
  return camera;
}

// The pose of the sheet from one camera whose model is known.
Pose pose_by_camera(const CameraModel& camera, const Corners& corners, const std::vector<Eigen::Vector3d>& sheet) {
  std::vector<cv::Point3d> objects;
  std::vector<cv::Point2d> images;
  for (size_t i = 0; i < corners.size(); ++i) {
    const Eigen::Vector3d ray = camera.unproject(corners.points[i]);
    if (!(ray.z() > 0.05)) continue;
    const Eigen::Vector3d& p = sheet[static_cast<size_t>(corners.ids[i])];
    objects.emplace_back(p.x(), p.y(), p.z());
    images.emplace_back(ray.x() / ray.z(), ray.y() / ray.z());
  }
  cv::Mat rotation, translation;
  if (objects.size() < 4 || !cv::solvePnP(objects, images, cv::Mat::eye(3, 3, CV_64F), cv::noArray(), rotation,
                                          translation, false, cv::SOLVEPNP_ITERATIVE)) {
    return Pose(Eigen::Translation3d(0, 0, 1));
  }
  return pose_from_cv(rotation, translation);
}

// How far apart two transforms between the cameras are: the shift that both make of a point at the distance `reach`.
double difference(const Pose& a, const Pose& b, double reach) {
  return (a.translation() - b.translation()).norm() +
         reach * rotation_angle(Eigen::Matrix3d(a.linear().transpose() * b.linear()));
}

double rms_of(double sum, int count) { return count == 0 ? 0 : std::sqrt(sum / count); }

// --- the joint optimisation ----------------------------------------------------------------------------------------

// (2.8), and where wanted the places of the corners on the sheet as well: prints and boards are not perfect.
class JointProblem {
 public:
  // `sheet_sigma` [m]: standard deviation of the corners from their places in `sheet`; 0 = they are exactly there.
  JointProblem(const std::vector<TargetView>& views, const std::vector<Eigen::Vector3d>& sheet, const Lens& lens,
               const StereoCalibration& start, const std::vector<Pose>& left_from_grid, double sheet_sigma)
      : lens_(lens),
        sheet_sigma_(sheet_sigma),
        left_(intrinsics_of(start.left)),
        right_(intrinsics_of(start.right)),
        right_from_left_(transform_of(start.right_from_left)) {
    for (const Pose& pose : left_from_grid) grids_.push_back(transform_of(pose));
    for (const Eigen::Vector3d& p : sheet) sheet_.push_back({p.x(), p.y(), p.z()});
    ceres::Problem::Options options;
    options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    problem_ = std::make_unique<ceres::Problem>(options);
    loss_ = std::make_unique<ceres::LossFunctionWrapper>(nullptr, ceres::TAKE_OWNERSHIP);
    for (size_t v = 0; v < views.size(); ++v) {
      for (size_t i = 0; i < views[v].left.size(); ++i) {
        add_left(static_cast<size_t>(views[v].left.ids[i]), views[v].left.points[i], v);
      }
      for (size_t i = 0; i < views[v].right.size(); ++i) {
        add_right(static_cast<size_t>(views[v].right.ids[i]), views[v].right.points[i], v);
      }
      corners_ += views[v].left.size() + views[v].right.size();
    }
    for (size_t i = 0; i < sheet.size(); ++i) {
      if (sheet_sigma_ == 0) {
        if (problem_->HasParameterBlock(sheet_[i].data())) problem_->SetParameterBlockConstant(sheet_[i].data());
      } else {
        problem_->AddResidualBlock(
            new ceres::AutoDiffCostFunction<SheetResidual, 3, 3>(new SheetResidual{sheet[i], &sheet_weight_}), nullptr,
            sheet_[i].data());
      }
    }
    // Coefficients that the model has not stay 0.
    std::vector<int> constant;
    for (int i = 4 + lens.coefficients; i < kIntrinsics; ++i) constant.push_back(i);
    for (Intrinsics* camera : {&left_, &right_}) {
      if (!constant.empty()) {
        problem_->SetManifold(camera->data(), new ceres::SubsetManifold(kIntrinsics, constant));
      }
    }
  }

  // Squares alone if scale is 0, otherwise Huber (or Cauchy, which also forgets gross errors). `corner_sigma` [px]: of
  // a coordinate in the images, against which the sheet's is weighed.
  bool solve(double scale, bool cauchy, double corner_sigma, int iterations = 200) {
    if (sheet_sigma_ > 0) sheet_weight_ = corner_sigma / sheet_sigma_;
    ceres::LossFunction* loss = nullptr;
    if (scale > 0 && cauchy) loss = new ceres::CauchyLoss(scale);
    if (scale > 0 && !cauchy) loss = new ceres::HuberLoss(scale);
    loss_->Reset(loss, ceres::TAKE_OWNERSHIP);
    scale_ = scale;
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::DENSE_SCHUR;
    options.num_threads = 1;  // the same sums on every machine
    options.max_num_iterations = iterations;
    options.function_tolerance = 1e-12;
    options.parameter_tolerance = 1e-12;
    options.gradient_tolerance = 1e-14;
    options.logging_type = ceres::SILENT;
    // Coefficients of rational lenses are nearly redundant: steps stay damped a little, or the equations have no
    // solution.
    options.max_trust_region_radius = 1e9;
    ceres::Solver::Summary summary;
    ceres::Solve(options, problem_.get(), &summary);
    cost_ = summary.final_cost;
    return summary.IsSolutionUsable();
  }

  // Half the sum of squares (under the loss) of the last solution.
  double cost() const { return cost_; }

  // [px] corner - projection of all corners, in the order of views: left, then right.
  std::vector<Vec> residuals() const {
    std::vector<double> values;
    ceres::Problem::EvaluateOptions options;
    options.apply_loss_function = false;
    options.num_threads = 1;
    problem_->Evaluate(options, nullptr, &values, nullptr, nullptr);
    std::vector<Vec> residuals;
    for (size_t i = 0; i < corners_; ++i) residuals.emplace_back(values[2 * i], values[2 * i + 1]);
    return residuals;
  }

  // Weight of a corner under the last Huber loss.
  double weight(const Vec& residual) const {
    const double r = residual.norm();
    return scale_ > 0 && r > scale_ ? scale_ / r : 1;
  }

  // sigma^2 (J' W J)^-1, the part of the calibration; sigma from the weighted errors. False if it has no inverse.
  bool covariance(Eigen::MatrixXd& covariance, double& sigma) const {
    ceres::Problem::EvaluateOptions options;
    options.apply_loss_function = false;
    options.num_threads = 1;
    options.parameter_blocks = {const_cast<double*>(left_.data()), const_cast<double*>(right_.data()),
                                const_cast<double*>(right_from_left_.data())};
    for (const Transform& grid : grids_) options.parameter_blocks.push_back(const_cast<double*>(grid.data()));
    for (const auto& corner : sheet_) {
      if (sheet_sigma_ > 0) options.parameter_blocks.push_back(const_cast<double*>(corner.data()));
    }
    std::vector<double> residuals;
    ceres::CRSMatrix jacobian;
    problem_->Evaluate(options, nullptr, &residuals, nullptr, &jacobian);
    Eigen::MatrixXd information = Eigen::MatrixXd::Zero(jacobian.num_cols, jacobian.num_cols);
    double sum = 0, weights = 0;
    for (int row = 0; row < jacobian.num_rows; ++row) {
      const auto pair = static_cast<size_t>(row) / 2 * 2;
      const double w = pair < 2 * corners_ ? weight({residuals[pair], residuals[pair + 1]}) : 1;
      sum += w * residuals[static_cast<size_t>(row)] * residuals[static_cast<size_t>(row)];
      weights += w;
      const int begin = jacobian.rows[static_cast<size_t>(row)], end = jacobian.rows[static_cast<size_t>(row) + 1];
      for (int a = begin; a < end; ++a) {
        for (int b = begin; b < end; ++b) {
          information(jacobian.cols[static_cast<size_t>(a)], jacobian.cols[static_cast<size_t>(b)]) +=
              w * jacobian.values[static_cast<size_t>(a)] * jacobian.values[static_cast<size_t>(b)];
        }
      }
    }
    const double freedom = weights - jacobian.num_cols;
    if (!(freedom > 0)) return false;
    sigma = std::sqrt(sum / freedom);
    // Columns of very different size: scaled to 1 on the diagonal first.
    const Eigen::VectorXd scale = information.diagonal().cwiseSqrt();
    if (!(scale.minCoeff() > 0)) return false;
    information = scale.cwiseInverse().asDiagonal() * information * scale.cwiseInverse().asDiagonal();
    const Eigen::LDLT<Eigen::MatrixXd> solver(information);
    constexpr double kSingular = 1e-14;
    if (solver.info() != Eigen::Success || !(solver.vectorD().minCoeff() > kSingular)) return false;
    const int n = 2 * (4 + lens_.coefficients) + 6;
    const Eigen::MatrixXd all = solver.solve(Eigen::MatrixXd::Identity(information.rows(), information.cols()));
    covariance =
        sigma * sigma *
        (scale.cwiseInverse().asDiagonal() * all * scale.cwiseInverse().asDiagonal()).eval().topLeftCorner(n, n);
    return covariance.allFinite();
  }

  void result(StereoCalibration& calibration, std::vector<Pose>& left_from_grid,
              std::vector<Eigen::Vector3d>& sheet) const {
    set_intrinsics(calibration.left, left_.data());
    set_intrinsics(calibration.right, right_.data());
    calibration.right_from_left = pose_of(right_from_left_.data());
    left_from_grid.clear();
    for (const Transform& grid : grids_) left_from_grid.push_back(pose_of(grid.data()));
    sheet.clear();
    for (const auto& corner : sheet_) sheet.emplace_back(corner[0], corner[1], corner[2]);
  }

 private:
  template <bool kFisheye>
  void add_left_as(size_t corner, const Vec& seen, size_t view) {
    problem_->AddResidualBlock(
        new ceres::AutoDiffCostFunction<LeftResidual<kFisheye>, 2, kIntrinsics, 6, 3>(new LeftResidual<kFisheye>{seen}),
        loss_.get(), left_.data(), grids_[view].data(), sheet_[corner].data());
  }
  template <bool kFisheye>
  void add_right_as(size_t corner, const Vec& seen, size_t view) {
    problem_->AddResidualBlock(new ceres::AutoDiffCostFunction<RightResidual<kFisheye>, 2, kIntrinsics, 6, 6, 3>(
                                   new RightResidual<kFisheye>{seen}),
                               loss_.get(), right_.data(), right_from_left_.data(), grids_[view].data(),
                               sheet_[corner].data());
  }
  void add_left(size_t corner, const Vec& seen, size_t view) {
    lens_.distortion == Distortion::equidistant ? add_left_as<true>(corner, seen, view)
                                                : add_left_as<false>(corner, seen, view);
  }
  void add_right(size_t corner, const Vec& seen, size_t view) {
    lens_.distortion == Distortion::equidistant ? add_right_as<true>(corner, seen, view)
                                                : add_right_as<false>(corner, seen, view);
  }

  Lens lens_;
  double sheet_sigma_ = 0, sheet_weight_ = 0;  // [m] [px/m]
  Intrinsics left_, right_;
  Transform right_from_left_;
  std::vector<Transform> grids_;
  std::vector<std::array<double, 3>> sheet_;
  size_t corners_ = 0;  // in all images
  double scale_ = 0, cost_ = 0;
  std::unique_ptr<ceres::LossFunctionWrapper> loss_;
  std::unique_ptr<ceres::Problem> problem_;
};

// [px] of one coordinate of a corner, from the median of the errors: gross ones do not count.
double corner_sigma(const JointProblem& joint) {
  std::vector<double> lengths;
  for (const Vec& r : joint.residuals()) lengths.push_back(r.norm());
  constexpr double kRayleighMedian = 1.1774;  // of the length of a vector whose coordinates have sigma = 1
  return std::max(1e-3, median(lengths) / kRayleighMedian);
}

// The solution in which the sheet's corners have found their places, if it explains the images better than a perfect
// sheet, otherwise `flat`, which is solved. Better: the errors fall by more than twice of what as many parameters
// without meaning would take from noise (Akaike's criterion as a ratio of variances).
std::unique_ptr<JointProblem> with_places_of_corners(std::unique_ptr<JointProblem> flat,
                                                     const std::vector<TargetView>& views,
                                                     const std::vector<Eigen::Vector3d>& sheet, const Lens& lens,
                                                     const CalibrateOptions& options) {
  StereoCalibration calibration;
  std::vector<Pose> left_from_grid;
  std::vector<Eigen::Vector3d> places;
  flat->result(calibration, left_from_grid, places);
  Eigen::Vector3d least = sheet.front(), most = sheet.front();
  for (const Eigen::Vector3d& p : sheet) {
    least = least.cwiseMin(p);
    most = most.cwiseMax(p);
  }
  const double sigma = corner_sigma(*flat);
  auto uneven = std::make_unique<JointProblem>(views, sheet, lens, calibration, left_from_grid,
                                               options.flatness * (most - least).maxCoeff());
  constexpr int kTrial = 4;  // steps that tell: the start is near, the corners enter almost linearly
  if (!uneven->solve(options.robust * sigma, false, sigma, kTrial)) return flat;
  const auto added = static_cast<double>(3 * sheet.size());
  const double freedom = 2 * static_cast<double>(flat->residuals().size()) - added -
                         static_cast<double>(2 * (4 + lens.coefficients) + 6 + 6 * static_cast<int>(views.size()));
  constexpr double kBetter = 2;
  if (!(freedom > 0) || (flat->cost() - uneven->cost()) / added < kBetter * uneven->cost() / freedom) return flat;
  const double smaller = corner_sigma(*uneven);
  if (!uneven->solve(options.robust * smaller, false, smaller)) return flat;
  return uneven;
}

void set_parameters(StereoCalibrationResult& result) {
  const StereoCalibration& c = result.calibration;
  static constexpr const char* kRadTan[] = {"k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"};
  static constexpr const char* kFisheye[] = {"k1", "k2", "k3", "k4"};
  const Eigen::VectorXd values = parameters_of(c);
  Eigen::Index at = 0;
  const auto add = [&](const std::string& name, const char* unit, double factor) {
    result.parameters.push_back({name, unit, factor * values(at), factor * std::sqrt(result.covariance(at, at))});
    ++at;
  };
  for (const auto& [camera, side] : {std::pair(&c.left, "left"), std::pair(&c.right, "right")}) {
    for (const char* name : {"fx", "fy", "cx", "cy"}) add(fmt::format("{} {}", side, name), "px", 1);
    for (size_t i = 0; i < camera->coefficients.size(); ++i) {
      add(fmt::format("{} {}", side, camera->distortion == Distortion::equidistant ? kFisheye[i] : kRadTan[i]), "", 1);
    }
  }
  for (const char* name : {"rotation x", "rotation y", "rotation z"}) add(name, "deg", kDegrees);
  for (const char* name : {"translation x", "translation y", "translation z"}) add(name, "mm", 1000);
}

}  // namespace

Eigen::VectorXd parameters_of(const StereoCalibration& c) {
  const size_t left = 4 + c.left.coefficients.size(), right = 4 + c.right.coefficients.size();
  Eigen::VectorXd values(static_cast<Eigen::Index>(left + right + 6));
  const Intrinsics l = intrinsics_of(c.left), r = intrinsics_of(c.right);
  const Transform t = transform_of(c.right_from_left);
  std::copy_n(l.begin(), left, values.data());
  std::copy_n(r.begin(), right, values.data() + left);
  std::copy_n(t.begin(), 6, values.data() + left + right);
  return values;
}

StereoCalibration with_parameters(const StereoCalibration& like, const Eigen::VectorXd& parameters) {
  StereoCalibration c = like;
  const size_t left = 4 + c.left.coefficients.size(), right = 4 + c.right.coefficients.size();
  IRIS_CHECK(parameters.size() == static_cast<Eigen::Index>(left + right + 6));
  set_intrinsics(c.left, parameters.data());
  set_intrinsics(c.right, parameters.data() + left);
  c.right_from_left = pose_of(parameters.data() + left + right);
  return c;
}

StereoCalibrationResult calibrate_stereo(const std::vector<TargetView>& views, const Target& target, int width,
                                         int height, const CalibrateOptions& options, const StereoCalibration* start) {
  StereoCalibrationResult result;
  const auto fail = [&](Status status, const std::string& problem, const std::string& remedy) {
    result.status = status;
    result.problem = problem;
    result.remedy = remedy;
    return result;
  };
  const std::vector<Eigen::Vector3d> sheet = target_points(target);
  const Lens lens = lens_of(options.distortion);
  std::vector<const Corners*> left_seen, right_seen;
  for (const TargetView& view : views) {
    if (!view.left.empty()) left_seen.push_back(&view.left);
    if (!view.right.empty()) right_seen.push_back(&view.right);
    result.pairs += view.is_pair();
    result.corners += static_cast<int>(view.left.size() + view.right.size());
  }
  result.left_views = static_cast<int>(left_seen.size());
  result.right_views = static_cast<int>(right_seen.size());
  for (const auto& [count, side, other] : {std::tuple(result.left_views, "left", result.right_views),
                                           std::tuple(result.right_views, "right", result.left_views)}) {
    if (count >= kLeastViews) continue;
    return fail(Status::too_few_views,
                fmt::format("the {} camera sees the target in {} usable images (the other one in {}); at least {} are "
                            "needed, 5 or more are good",
                            side, count, other, kLeastViews),
                "take more images in which both cameras see the target, tilted in different ways");
  }
  if (result.pairs < kLeastViews) {
    return fail(Status::too_few_views,
                fmt::format("both cameras see the target at once in {} pairs only; at least {} are needed",
                            result.pairs, kLeastViews),
                "take more images in which both cameras see the target");
  }

  // Each camera alone, and what each pair says of the transform between them.
  StereoCalibration& calibration = result.calibration;
  std::vector<Pose> left_poses(views.size(), Pose::Identity()), right_poses(views.size(), Pose::Identity());
  if (start) {
    calibration = *start;
    for (size_t v = 0; v < views.size(); ++v) {
      if (!views[v].left.empty()) left_poses[v] = pose_by_camera(calibration.left, views[v].left, sheet);
      if (!views[v].right.empty()) right_poses[v] = pose_by_camera(calibration.right, views[v].right, sheet);
    }
  } else {
    try {
      const SingleCamera left = calibrate_single(left_seen, sheet, lens, width, height);
      const SingleCamera right = calibrate_single(right_seen, sheet, lens, width, height);
      calibration.left = left.model;
      calibration.right = right.model;
      for (size_t v = 0, l = 0, r = 0; v < views.size(); ++v) {
        if (!views[v].left.empty()) left_poses[v] = left.cam_from_grid[l++];
        if (!views[v].right.empty()) right_poses[v] = right.cam_from_grid[r++];
      }
    } catch (const cv::Exception& error) {
      return fail(Status::no_fit, "the images do not determine the cameras (" + error.err + ")",
                  "tilt the target in different ways; for lenses of less than 100 degrees choose another "
                  "--calibrate.distortion than fisheye");
    }
    std::vector<Pose> transforms;
    std::vector<double> distances;
    for (size_t v = 0; v < views.size(); ++v) {
      if (!views[v].is_pair()) continue;
      transforms.push_back(right_poses[v] * left_poses[v].inverse());
      distances.push_back(left_poses[v].translation().norm());
    }
    const double reach = median(distances);
    const Pose* middle = nullptr;
    double least = 1e300, typical = 0;
    for (const Pose& a : transforms) {
      std::vector<double> to_others;
      for (const Pose& b : transforms) to_others.push_back(difference(a, b, reach));
      const double value = median(to_others);
      if (value < least) {
        least = value;
        middle = &a;
      }
    }
    typical = least;
    calibration.right_from_left = *middle;
    // A tenth of the target's distance is far more than any imprecise pair.
    constexpr double kInconsistent = 0.1;
    if (typical > kInconsistent * reach || rotation_angle(*middle) > std::numbers::pi / 3) {
      return fail(Status::inconsistent,
                  fmt::format("the pairs contradict each other about where the right camera stands (by {:.0f} mm for a "
                              "target {:.0f} mm away)",
                              1000 * typical, 1000 * reach),
                  "see that left and right images belong together and are taken at the same moment, and that the "
                  "images of no camera are mirrored or turned");
    }
  }
  for (size_t v = 0; v < views.size(); ++v) {
    if (views[v].left.empty()) left_poses[v] = calibration.right_from_left.inverse() * right_poses[v];
  }

  auto joint = std::make_unique<JointProblem>(views, sheet, lens, calibration, left_poses, 0.0);
  const auto rms_now = [&] {
    double sum = 0;
    const std::vector<Vec> residuals = joint->residuals();
    for (const Vec& r : residuals) sum += r.squaredNorm();
    return residuals.empty() ? std::nan("") : rms_of(sum, static_cast<int>(residuals.size()));
  };
  result.start_rms = rms_now();
  bool solved = std::isfinite(result.start_rms);  // not if corners would lie behind a camera
  if (solved) {
    if (options.robust > 0) solved = joint->solve(1.0, true, 1.0);
    const double sigma = corner_sigma(*joint);
    solved = joint->solve(options.robust * sigma, false, sigma) && solved;
    if (solved && options.flatness > 0) joint = with_places_of_corners(std::move(joint), views, sheet, lens, options);
  }
  result.rms = rms_now();
  constexpr double kWorstRms = 5;  // [px]
  if (!solved || !(result.rms <= kWorstRms)) {
    return fail(Status::no_fit,
                std::isfinite(result.rms)
                    ? fmt::format("no rig explains the images: {:.1f} px remain between corners and model", result.rms)
                    : "no rig explains the images",
                "see that left and right images belong together and are taken at the same moment, that the target is "
                "flat and --target describes it, and that the images of no camera are mirrored");
  }
  joint->result(calibration, result.left_from_grid, result.sheet);
  for (size_t i = 0; i < sheet.size(); ++i) {
    const Eigen::Vector3d off = result.sheet[i] - sheet[i];
    result.sheet_along += off.head<2>().squaredNorm() / static_cast<double>(sheet.size());
    result.sheet_across += off.z() * off.z() / static_cast<double>(sheet.size());
  }
  result.sheet_along = std::sqrt(result.sheet_along);
  result.sheet_across = std::sqrt(result.sheet_across);
  if (calibration.right_centre_in_left().x() <= 0) {
    return fail(Status::mirrored,
                fmt::format("the right camera would stand {:.0f} mm left of the left one",
                            -1000 * calibration.right_centre_in_left().x()),
                "left and right are swapped, or the images (or the target) are mirrored");
  }

  const std::vector<Vec> residuals = joint->residuals();
  double left_sum = 0, right_sum = 0;
  int left_count = 0, right_count = 0;
  size_t at = 0;
  for (const TargetView& view : views) {
    ViewErrors errors;
    double left = 0, right = 0;
    for (size_t i = 0; i < view.left.size(); ++i) {
      errors.left.push_back(residuals[at++]);
      left += errors.left.back().squaredNorm();
    }
    for (size_t i = 0; i < view.right.size(); ++i) {
      errors.right.push_back(residuals[at++]);
      right += errors.right.back().squaredNorm();
    }
    left_sum += left;
    right_sum += right;
    left_count += static_cast<int>(view.left.size());
    right_count += static_cast<int>(view.right.size());
    errors.left_rms = rms_of(left, static_cast<int>(view.left.size()));
    errors.right_rms = rms_of(right, static_cast<int>(view.right.size()));
    result.errors.push_back(std::move(errors));
  }
  result.left_rms = rms_of(left_sum, left_count);
  result.right_rms = rms_of(right_sum, right_count);
  if (!joint->covariance(result.covariance, result.sigma)) {
    return fail(Status::no_fit, "the images do not determine all parameters of the cameras",
                "tilt the target in different ways and fill the whole image with it, or choose a lens model with fewer "
                "coefficients (--calibrate.distortion radial)");
  }
  set_parameters(result);
  return result;
}

}  // namespace iris::calibrate
