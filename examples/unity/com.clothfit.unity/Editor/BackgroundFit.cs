using UnityEditor;
using UnityEngine;

namespace Clothfit.Editing
{
    /// <summary>
    /// The fit that runs, with its line in Window > General > Progress, which can cancel it. It ends with the editor, and
    /// before scripts are loaded anew; the best so far is written then too.
    /// </summary>
    public static class BackgroundFit
    {
        static EstimateRun fit;
        static int line;

        public static bool Runs
        {
            get { return fit != null; }
        }

        /// <summary>Number of its process.</summary>
        public static int Id
        {
            get { return fit.Id; }
        }

        public static void Start(EstimateRun started, string name)
        {
            fit = started;
            line = Progress.Start("Clothfit: fits " + name, fit.Progress, Progress.Options.Indefinite | Progress.Options.Managed);
            Progress.RegisterCancelCallback(line, () =>
            {
                Cancel();
                return true;
            });
            EditorApplication.update += Look;
            EditorApplication.quitting += Cancel;
            AssemblyReloadEvents.beforeAssemblyReload += Cancel;
        }

        public static void Cancel()
        {
            if (fit != null) fit.Cancel();
        }

        static void Look()
        {
            Outcome? outcome = fit.Poll();
            if (outcome == null)
            {
                Progress.SetDescription(line, fit.Progress);
                return;
            }
            EstimateRun ended = fit;
            Stop();
            if (outcome == Outcome.Failed && !ended.Cancelled) Debug.LogError("Clothfit: " + ended.Message);
            else if (outcome == Outcome.Failed) Debug.Log("Clothfit: " + ended.Message);
            else Debug.Log("Clothfit: " + ended.Message + "\nClothfit > Import fitted takes the values of " + ended.FittedPath);
            Progress.Finish(line, outcome == Outcome.Failed ? (ended.Cancelled ? Progress.Status.Canceled : Progress.Status.Failed)
                : outcome == Outcome.Cancelled ? Progress.Status.Canceled : Progress.Status.Succeeded);
            ended.Dispose();
        }

        static void Stop()
        {
            fit = null;
            EditorApplication.update -= Look;
            EditorApplication.quitting -= Cancel;
            AssemblyReloadEvents.beforeAssemblyReload -= Cancel;
        }
    }
}
