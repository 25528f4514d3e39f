using System;
using System.Collections.Generic;
using System.Linq;
using UnityEngine;

namespace Clothfit
{
    /// <summary>From a fitted scene back to the components that it was made of.</summary>
    public static class SceneImport
    {
        /// <summary>
        /// Takes the values that the components flag for fits, and the time step. Throws InvalidOperationException, and
        /// changes nothing, where the file is not of this scene.
        /// </summary>
        public static void Apply(SceneFile file, ClothfitScene settings)
        {
            SceneFile own = SceneBuilder.Build(settings);
            Check(file, own);
            List<ClothfitCloth> cloths = settings.All<ClothfitCloth>();
            for (int k = 0; k < cloths.Count; k++) Take(cloths[k], file.Scene.objects[k], file.Extras.objects[k]);
            List<ClothfitFixer> fixers = settings.All<ClothfitFixer>();
            for (int k = 0; k < cloths.Count; k++)
                if (cloths[k].fitPaths) TakePaths(fixers, own.Scene.objects[k], file.Extras.objects[k]);
            TakeScene(file, settings);
        }

        /// <summary>What Apply changes.</summary>
        public static IEnumerable<MonoBehaviour> Changed(ClothfitScene settings)
        {
            return settings.All<MonoBehaviour>().Where(each => each is ClothfitScene || each is ClothfitCloth
                || each is ClothfitFixer || each is ClothfitObstacle || each is ClothfitWind);
        }

        static void Check(SceneFile file, SceneFile own)
        {
            int objects = own.Scene.objects.Count, colliders = own.Scene.colliders.Count;
            if (file.Scene.objects.Count != objects) throw Other("objects", file.Scene.objects.Count, objects);
            if (file.Scene.colliders.Count != colliders) throw Other("colliders", file.Scene.colliders.Count, colliders);
            for (int k = 0; k < objects; k++)
            {
                ObjectData theirs = file.Scene.objects[k], ours = own.Scene.objects[k];
                if (theirs.vertMass.Count != ours.vertMass.Count) throw Other("masses", theirs.vertMass.Count, ours.vertMass.Count);
                if (!theirs.springs.SequenceEqual(ours.springs) || theirs.springStiffness.Count != ours.springStiffness.Count)
                    throw new InvalidOperationException("object " + k + " of the file has other springs than the mesh");
            }
        }

        static Exception Other(string what, int theirs, int ours)
        {
            return new InvalidOperationException("the file has " + theirs + " " + what + ", the scene has " + ours
                + "; was the scene changed after the export?");
        }

        static void Take(ClothfitCloth cloth, ObjectData data, ObjectExtras extras)
        {
            FittedValues found = cloth.fitted;
            if (cloth.fitMass != FittedMany.No) found.masses = data.vertMass;
            if (cloth.fitStiffness != FittedMany.No) found.stiffnesses = data.springStiffness;
            if (cloth.fitRestLength != FittedMany.No) found.restLengths = extras.springRestLength;
            if (cloth.fitVelocity != Fitted.No) found.velocities = extras.vertVel;
            if (cloth.fitDamping) cloth.damping = data.damping;
            if (cloth.fitDrag) cloth.drag = data.dragCoefficient;
            if (!cloth.fitPinOffset || !Unset.Has(extras.pinOffset)) return;
            found.moved = true;
            found.pinOffset = extras.pinOffset;
        }

        /// <summary>Takes the keys of each pin. Where cloths share a fixer, those of the last one count.</summary>
        static void TakePaths(List<ClothfitFixer> fixers, ObjectData data, ObjectExtras found)
        {
            var pins = SceneBuilder.Pins(data, fixers);
            for (int k = 0; k < Math.Min(pins.Count, found.pins.Count); k++) pins[k].Key.positionKeys.Take(found.pins[k].posKeys);
        }

        static void TakeScene(SceneFile file, ClothfitScene settings)
        {
            SceneExtras extras = file.Extras;
            settings.timeStep = file.Scene.delta;
            settings.integrator = (Integrator)file.Scene.integrationMethod;
            settings.frames = file.Scene.optimizationIterations;
            settings.newtonIterations = file.Scene.forwardSubSteps;
            ClothfitWind wind = settings.All<ClothfitWind>().FirstOrDefault();
            if (wind != null && settings.fitWind) wind.velocity = file.Scene.windVel;
            if (wind != null && settings.fitWindKeys) wind.keys.Take(extras.windVelKeys);
            if (settings.fitGravity && Unset.Has(extras.gravity))
            {
                settings.ownGravity = true;
                settings.gravity = extras.gravity;
            }
            if (settings.fitObstacleOffset && Unset.Has(extras.colliderOffset)) settings.obstacleOffset = extras.colliderOffset;
            bool stiffness = settings.fitContact != Fitted.No, friction = settings.fitFriction != Fitted.No;
            List<ClothfitObstacle> obstacles = settings.All<ClothfitObstacle>();
            for (int k = 0; k < obstacles.Count; k++)
                obstacles[k].contact.Take(stiffness ? extras.colliders[k].stiffness : float.NaN,
                    friction ? extras.colliders[k].friction : float.NaN);
            settings.selfContact.Take(stiffness ? extras.selfCollision.stiffness : float.NaN,
                friction ? extras.selfCollision.friction : float.NaN);
        }
    }
}
