using System;
using UnityEditor;
using UnityEngine;

namespace Clothfit.Editing
{
    /// <summary>A short call of the command line beside the editor, and what follows when it has succeeded.</summary>
    public static class BackgroundCall
    {
        public static void Start(CommandRun run, string name, Action done)
        {
            int line = Progress.Start("Clothfit: " + name, null, Progress.Options.Indefinite | Progress.Options.Managed);
            EditorApplication.CallbackFunction look = null;
            look = () =>
            {
                int? code = run.Ended();
                if (code == null) return;
                EditorApplication.update -= look;
                Progress.Finish(line, code == 0 ? Progress.Status.Succeeded : Progress.Status.Failed);
                if (code == 0) done();
                else Debug.LogError("Clothfit: " + run.Fault);
                run.Dispose();
            };
            EditorApplication.update += look;
        }
    }
}
